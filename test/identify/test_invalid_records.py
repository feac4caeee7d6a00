# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Identification refuses records that are no measurement of their command, by name and before it fits; --force fits them all the same."""

import numpy as np
import pytest

from hyst_control.base.config_files import config_path
from hyst_control.base.errors import InputError
from hyst_control.cli import main
from hyst_control.identify import workflow
from hyst_control.model_file import load_model, simulate
from hyst_control.records.excitation.excitation import build
from hyst_control.records.record import Record, Signal
from hyst_control.records.tables.importing import write_bag


def bag(path, command, measurement, sample_time):
    time = np.arange(len(command)) * sample_time
    signals = {"command": Signal(time, command, ("x",), "V"), "measurement": Signal(time, measurement, ("x",), "um")}
    write_bag(path, Record(signals, "made"))
    return str(path)


@pytest.fixture(scope="module")
def records(tmp_path_factory):
    model = load_model(config_path("models/pea_hampi.yaml"))
    folder = tmp_path_factory.mktemp("records")
    step = 4 * model.sample_time
    command = build({"signal": "diagnostic", "lowest": 0.0, "highest": 50.0, "duration": 0.6, "band": 300.0}, step)
    other = build({"signal": "steps", "lowest": 0.0, "highest": 50.0, "hold": 0.02, "count": 12}, step)
    random = np.random.default_rng(0)
    measured, again = (simulate(model, u, step) + 0.003 * random.normal(size=u.shape) for u in (command, other))
    return {
        "sound": bag(folder / "sound", command, measured, step),
        "noise_alone": bag(folder / "noise", command, random.normal(size=command.shape), step),
        "shuffled_command": bag(folder / "shuffled", random.permutation(command), measured, step),
        "reversed_command": bag(folder / "reversed", np.ascontiguousarray(command[::-1]), measured, step),
        "sign_turned": bag(folder / "turned", -other, again, step),
        "different_plants": bag(folder / "other", other, 4.0 * again, step),
    }


@pytest.mark.parametrize(
    "name, words",
    [
        ("noise_alone", "noise that no command explains"),
        ("shuffled_command", "in no order that the measurement knows"),
        ("reversed_command", "read backwards"),
        ("sign_turned", "against another record"),
        ("different_plants", "as different plants do"),
    ],
)
def test_it_is_refused_by_name_and_fitted_when_forced(name, words, records, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(workflow, "identify", fitted)
    bags = [records["sound"], records[name]]
    output = tmp_path / "model.yaml"
    arguments = ["identify", *bags, "--model", "linear", "--output", str(output)]
    assert main(arguments) == 2 and not output.exists()
    line = capsys.readouterr().err
    assert line.count("\n") == 1 and words in line
    assert main([*arguments, "--force"]) == 2 and "2 records reached the fit" in capsys.readouterr().err


def fitted(records, *_, **__):
    raise InputError(f"{len(records)} records reached the fit")


def test_a_sound_record_is_fitted(records, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(workflow, "identify", fitted)
    assert main(["identify", records["sound"], "--model", "linear", "--output", str(tmp_path / "model.yaml")]) == 2
    assert "1 records reached the fit" in capsys.readouterr().err
