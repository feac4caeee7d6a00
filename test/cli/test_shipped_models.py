# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Every shipped model through the commands that take one: each works, or is refused in one line that says why."""

from __future__ import annotations

import json

import pytest

from hyst_control.base.config_files import config_path
from hyst_control.cli import main
from hyst_control.effects import EFFECTS
from hyst_control.model_file import load_model

MODELS = sorted(path.stem for path in config_path("models/pea_hampi.yaml").parent.glob("*.yaml"))
ROWS = 400
REFUSED = {
    ("tune", "fsm_cubespec"): "the output falls when the command rises at rest",
    ("tune", "fsm_mhl_inverse"): "is an inverse model, from mrad to V",
}
"""What is refused, and the words that say why."""

CANDIDATES = ("gain", "offset")
"""Effects that the diagnosis looks for here: every other only costs time."""


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    """A short bag of every model, simulated with its own noise within its range of commands."""
    folder = tmp_path_factory.mktemp("bags")
    found = {}
    for name in MODELS:
        model = load_model(config_path(f"models/{name}.yaml"))
        lowest, highest = model.valid.get("command", [0.0, 2.0])
        hold = ROWS / 20 * model.sample_time
        words = [f"lowest={lowest}", f"highest={highest}", f"hold={hold}", "count=20"]
        assert main(["simulate", path(name), "--excitation", "steps", *words, "--output", str(folder / name), "--seed", "1"]) == 0
        found[name] = str(folder / name)
    return found


def path(name):
    return str(config_path(f"models/{name}.yaml"))


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("command", ["validate", "tune", "diagnose"])
def test_a_shipped_model_works_or_is_refused_in_one_line(command, name, bags, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    without = [word for effect in EFFECTS if effect not in CANDIDATES for word in ("--without", effect)]
    arguments = {
        "validate": [path(name), bags[name]],
        "tune": [path(name)],
        "diagnose": [bags[name], "--model", path(name), *without],
    }[command]
    out = tmp_path / "out.json"
    status = main([command, *arguments, "--quiet", "--json", str(out)])
    told = capsys.readouterr().err
    if reason := REFUSED.get((command, name)):
        assert status == 2 and reason in told and told.count("\n") == 1
        return
    assert status == 0, told
    document = json.loads(out.read_text())
    if command == "diagnose":  # the record is the model's own
        assert document["verdict"] == "no_gap"
    elif command == "validate":
        errors = [row["value"] for row in document["rows"] if row["quantity"] == "nrmse"]
        assert errors and max(errors) < 10.0  # %: nothing but the noise
