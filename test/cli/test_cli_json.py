# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""`--json` and the help, the same for every subcommand; what the documents hold is held against the files themselves."""

from __future__ import annotations

import argparse
import hashlib
import json
import shlex
import subprocess
import sys

import numpy as np
import pytest

from hyst_control.base import progress
from hyst_control.base.config_files import config_path
from hyst_control.cli import main, parser

MODEL = str(config_path("models/pea_hampi.yaml"))
COMMANDS = next(action for action in parser()._actions if isinstance(action, argparse._SubParsersAction)).choices
MEANINGS = {
    "--rate": "Hz",
    "--output": "write",
    "--seed": "seed|of",
    "--namespace": "topics",
    "--json": "JSON",
    "--hold": "foh",
    "--unit": "um",
}
"""What an option of this name is about, wherever it is offered."""


@pytest.mark.parametrize("name", COMMANDS)
def test_every_subcommand_writes_json_shows_an_example_and_explains_its_options(name):
    command = COMMANDS[name]
    options = {word: action for action in command._actions for word in action.option_strings}
    assert "--json" in options and "--quiet" in options and options["--json"].metavar == "OUT"
    assert f"example:\n  hyst {name}" in command.description or f"examples:\n  hyst {name}" in command.description
    assert "--out" not in options and "--sample-time" not in options
    for word, action in options.items():
        if word in MEANINGS:
            assert any(part in action.help for part in MEANINGS[word].split("|")), f"hyst {name} {word}: {action.help}"
    assert all(action.help for action in command._actions)


@pytest.mark.parametrize(
    "line",
    [line.strip() for name in COMMANDS for line in COMMANDS[name].description.splitlines() if line.startswith(f"  hyst {name}")],
)
def test_every_example_parses(line):
    words = line.partition(" #")[0].split("   ")[0]
    parser().parse_args(shlex.split(words)[1:])


def document(capsys, *arguments):
    """What a command prints with `--json -`, and what it tells on the standard error."""
    assert main([*arguments, "--json", "-"]) == 0
    out, told = capsys.readouterr()
    return json.loads(out), told


def test_what_was_made_is_told_with_sizes_hashes_and_counts(tmp_path, capsys):
    file = tmp_path / "drive.csv"
    found, told = document(
        capsys,
        "excite",
        "sine",
        "frequency=10",
        "amplitude=20",
        "offset=25",
        "duration=0.2",
        "--rate",
        "5000",
        "--output",
        str(file),
    )
    assert found["schema"] == "hyst_control/made" and found["version"] == 1 and found["source"] == "excite"
    assert found["files"] == [
        {"path": str(file), "kind": "file", "bytes": file.stat().st_size, "sha256": hashlib.sha256(file.read_bytes()).hexdigest()}
    ]
    values = {row["quantity"]: (row["value"], row["unit"]) for row in found["rows"]}
    assert values["samples"] == (1000, "") and values["duration"] == (0.2, "s") and values["maximum"][0] == pytest.approx(45.0)
    assert values["slope"] == (pytest.approx(2 * np.pi * 10 * 20, rel=1e-3), "V/s")
    assert f"written: {file}" in told

    bag = tmp_path / "drive.bag"
    imported, _ = document(capsys, "import", str(file), "--output", str(bag), "--columns", "command=2[V]", "--rate", "5000")
    [folder] = imported["files"]
    assert imported["rows"] == [{"case": "command", "quantity": "samples", "unit": "", "value": 1000}]
    listed = subprocess.run(
        "find . -type f -printf '%P\\n' | LC_ALL=C sort | xargs sha256sum | sha256sum",
        shell=True,
        cwd=bag,
        capture_output=True,
        text=True,
        check=True,
    ).stdout.split()[0]
    assert folder["kind"] == "folder" and folder["sha256"] == listed

    simulated, _ = document(capsys, "simulate", MODEL, str(bag), "--output", str(tmp_path / "simulated"))
    assert {row["quantity"]: row["value"] for row in simulated["rows"]}["samples"] == 1000

    table, told = document(capsys, "validate", MODEL, str(tmp_path / "simulated"))
    assert table["schema"] == "hyst_control/table" and table["source"] == "validate"
    assert next(row for row in table["rows"] if row["quantity"] == "nrmse")["value"] < 1e-6 and "validation" in told


def test_kinds_of_signals_are_told_with_their_parameters(capsys):
    found, told = document(capsys, "excite", "--list")
    assert found["kinds"]["sine"]["parameters"]["frequency"] is None and found["kinds"]["sine"]["parameters"]["offset"] == 0.0
    assert "sine frequency" in told


def test_a_place_that_cannot_be_written_is_told_before_the_work(tmp_path, capsys):
    output = tmp_path / "drive.csv"
    assert (
        main(
            [
                "excite",
                "sine",
                "frequency=10",
                "amplitude=2",
                "duration=0.1",
                "--output",
                str(output),
                "--json",
                str(tmp_path / "nowhere" / "made.json"),
            ]
        )
        == 2
    )
    assert "nowhere" in capsys.readouterr().err and not output.exists()


def test_a_refusal_leaves_the_standard_output_empty(tmp_path, capsys):
    assert main(["validate", MODEL, str(tmp_path / "none"), "--json", "-"]) == 2
    assert capsys.readouterr().out == ""


class Terminal:
    """Stands in for the standard error."""

    def __init__(self, is_terminal):
        self._is_terminal, self.written = is_terminal, ""

    def isatty(self):
        return self._is_terminal

    def write(self, text):
        self.written += text

    def flush(self):
        pass


@pytest.mark.parametrize("is_terminal, wanted", [(True, True), (True, False), (False, True)])
def test_progress_shows_on_a_terminal_and_its_parts_elsewhere(monkeypatch, is_terminal, wanted):
    terminal = Terminal(is_terminal)
    monkeypatch.setattr(sys, "stderr", terminal)
    with progress.shown(wanted):
        with progress.steps(2) as part:
            part("first")
            part("second")
            progress.step("inner")
        progress.step("after")
    assert bool(terminal.written) == wanted
    if not is_terminal:
        assert terminal.written == "1/2 first\n2/2 second\n"
    elif wanted:
        assert "1/2 first" in terminal.written and "2/2 second: inner" in terminal.written and "after" in terminal.written
    progress.step("nobody listens")


def test_the_address_of_a_page_is_printed_while_it_is_served(monkeypatch, capsys):
    dashboard = pytest.importorskip("hyst_control.nodes.dashboard", reason="the live page is a node and needs rclpy")

    def serve(*settings):
        settings[-1]("http://127.0.0.1:1/token/")
        assert json.loads(capsys.readouterr().out) == {"url": "http://127.0.0.1:1/token/"}
        return 0

    monkeypatch.setattr(dashboard, "serve", serve)
    assert main(["dashboard", "--json", "-"]) == 0 and not capsys.readouterr().out  # once
