# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""An output that is an input is refused before anything is read, whatever command and argument name it."""

from __future__ import annotations

import argparse

import pytest

from hyst_control.cli import main, parser

FILES = ("BAG", "MODEL", "FILE", "BASELINE", "MANIFEST", "COMMAND", "PLANT", "WORD", "KIND parameter")
"""Beginnings of what the help calls arguments that may name files which are read."""
NAMES_ONLY = {"cases": {"plants", "kinds"}, "blind-test": {"plants"}}
"""Arguments that are called so, but name nothing that a user made."""


def test_every_argument_that_names_a_file_is_declared():
    [commands] = [action for action in parser()._actions if isinstance(action, argparse._SubParsersAction)]
    for name, command in commands.choices.items():
        known = {*command._defaults["reads"], *command._defaults["writes"], *NAMES_ONLY.get(name, ())}
        named = {action.dest for action in command._actions if str(action.metavar).startswith(FILES)}
        assert named <= known, name


@pytest.mark.parametrize(
    "words",
    [
        ("diagnose", "bag", "--model", "model.yaml", "--baseline", "other", "--json", "other"),
        ("fleet", "identify", "other", "--output", "study", "--json", "other"),
        ("fleet", "validate", "bag", "--baseline", "other", "--output", "study", "--json", "other"),
        ("fleet", "population", "other", "--output", "other/records.parquet"),
        ("export", "model.yaml", "--kind", "hampi", "--inverse-model", "other", "--output", "other"),
        ("excite", "sine", "--plant", "other", "--output", "other"),
        ("learn", "model.yaml", "--reference", "other", "--json", "other"),
        ("learn", "other", "bag", "--period", "1", "--json", "other"),
        ("learn", "model.yaml", "bag", "--response", "other", "--period", "1", "--json", "other"),
    ],
)
def test_it_is_refused_in_one_line(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    if words[1] == "population":
        (tmp_path / "other").mkdir()
    else:
        (tmp_path / "other").write_text("kept")
    assert main(list(words)) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1 and ("is read as well" in told or "which is read" in told)
    assert [each.name for each in tmp_path.rglob("*")] == ["other"]
