# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Paths that are none: a link to itself, a file in place of a folder. One line, status 2, nothing written."""

from __future__ import annotations

import subprocess
import sys

import pytest

from hyst_control.base.config_files import config_path
from hyst_control.cli import main

MODEL = str(config_path("models/pea_hampi.yaml"))


@pytest.mark.parametrize(
    "words",
    [
        ("plot", "loop"),
        ("diagnose", "loop", "--model", MODEL),
        ("diagnose", "loop", "--model", "loop", "--json", "loop"),
        ("identify", "loop", "--output", "model.yaml"),
        ("identify", "bag", "--output", "loop/model.yaml"),
        ("simulate", MODEL, "loop", "--output", "simulated"),
        ("import", "loop.db3", "--output", "imported"),
        ("learn", MODEL, "loop", "--period", "0.1", "--output", "learned.npy"),
        ("fleet", "identify", "loop", "--output", "loop/study"),
    ],
)
def test_a_link_to_itself_is_refused_in_one_line(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for name in ("loop", "loop.db3"):
        (tmp_path / name).symlink_to(name)
    assert main(list(words)) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert sorted(each.name for each in tmp_path.iterdir()) == ["loop", "loop.db3"]


def test_doctor_looks_at_a_folder_that_is_a_link_to_itself(tmp_path):
    from hyst_control.processes.installation import Verdict, disk

    (tmp_path / "loop").symlink_to("loop")
    found = disk(tmp_path / "loop")
    assert found.verdict is Verdict.FAULT and str(tmp_path / "loop") in found.found


def test_the_command_line_runs_without_its_script_on_the_path(tmp_path):
    said = subprocess.run([sys.executable, "-m", "hyst_control", "check", "nowhere"], cwd=tmp_path, capture_output=True, text=True)
    assert (said.returncode, said.stderr) == (2, "hyst check: nowhere: does not exist: give the path of a bag\n")
