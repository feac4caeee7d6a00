# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The examples in the help of `identify`, `diagnose` and `edit` run as they stand; an error of usage is one line."""

from __future__ import annotations

import shlex
import shutil

import pytest

from hyst_control.base.config_files import config_path
from hyst_control.cli import diagnose as diagnose_command
from hyst_control.cli import edit as edit_command
from hyst_control.cli import identify as identify_command
from hyst_control.cli import main

SIGNAL = ("hampi_identification", "peak=50", "frequencies=[10,20]", "quasi_static=0.5", "time=0.1")


def examples(command) -> list[list[str]]:
    """Words of each example of a command's help."""
    text = command.__doc__.partition("example")[2]
    return [shlex.split(line, comments=True)[1:] for line in text.splitlines() if line.startswith("  hyst ")]


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A folder with the bags and the model that the examples name."""
    folder = tmp_path_factory.mktemp("examples")
    model = folder / "hampi.yaml"
    shutil.copy(config_path("models/pea_hampi.yaml"), model)
    for seed, name in enumerate(
        ("demo_out/bags/excitation", "loops", "sweeps", "record", "today", "yesterday", "monday", "tuesday")
    ):
        words = [*SIGNAL, "--rate", "1000", "--seed", str(seed), "--output", str(folder / name)]
        assert main(["simulate", str(model), "--excitation", *words]) == 0
    (folder / "joint.py").write_text("def simulate(command, sample_time, stiffness):\n    return stiffness * command\n")
    (folder / "prior.yaml").write_text("stiffness: [0.1, 0.01, um/V]\n")
    return folder


@pytest.mark.parametrize("words", examples(identify_command) + examples(diagnose_command) + examples(edit_command), ids=" ".join)
def test_an_example_runs(words, files, monkeypatch, capsys):
    monkeypatch.chdir(files)
    assert main([*words, "--quiet"]) == 0, capsys.readouterr().err


def test_the_default_name_of_a_model(files, monkeypatch):
    monkeypatch.chdir(files)
    (files / "model.yaml").unlink(missing_ok=True)
    assert main(["identify", "loops", "--model", "pi"]) == 0
    assert (files / "model.yaml").is_file()


@pytest.mark.parametrize(
    "words", [["identify"], ["identyfi"], ["tune", "model.yaml", "--rate", "fast"], ["plot", "run", "--bogus"]]
)
def test_an_error_of_usage_is_one_line(words, capsys):
    with pytest.raises(SystemExit) as ended:
        main(words)
    [line] = capsys.readouterr().err.splitlines()
    assert ended.value.code == 2 and line.startswith("hyst") and "--help" in line


def test_an_unknown_option_is_told_with_its_command(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["validate", "model.yaml", "record", "--model", "other.yaml"])
    assert ended.value.code == 2
    assert capsys.readouterr().err == "hyst validate: unrecognized arguments: --model other.yaml: see hyst validate --help\n"
