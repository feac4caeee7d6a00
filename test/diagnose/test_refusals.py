# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Input that cannot be diagnosed ends with one line and exit status 2, and nothing is written."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hyst_control.base.config_files import config_path
from hyst_control.base.errors import InputError
from hyst_control.cli import main as hyst
from hyst_control.diagnose.run.diagnosis import diagnose
from hyst_control.model_file import load_model
from hyst_control.records.record import Record, Signal
from hyst_control.records.tables.importing import write_bag

COUNT = 400
TIME = np.arange(COUNT) * 5e-5
MOVING = np.linspace(0.0, 40.0, COUNT)[:, None]


def record(**changes: Signal | None) -> Record:
    signals = {"command": Signal(TIME, MOVING, ("x",), "V"), "measurement": Signal(TIME, 0.1 * MOVING, ("x",), "um"), **changes}
    return Record({name: signal for name, signal in signals.items() if signal is not None}, "record")


def short(signal: Signal) -> Signal:
    return replace(signal, time=signal.time[:50], values=signal.values[:50])


GOOD = record().signals
BAD = {
    "other unit": record(measurement=replace(GOOD["measurement"], unit="mrad")),
    "other axes": record(
        command=Signal(TIME, np.repeat(MOVING, 2, axis=1), ("x", "y"), "V"),
        measurement=Signal(TIME, np.repeat(MOVING, 2, axis=1), ("x", "y"), "um"),
    ),
    "command of another unit": record(command=replace(GOOD["command"], unit="mV")),
    "command of another axis": record(command=replace(GOOD["command"], axes=("y",))),
    "number beyond any signal": record(measurement=replace(GOOD["measurement"], values=1e300 * MOVING)),
    "constant command": record(command=replace(GOOD["command"], values=np.full((COUNT, 1), 7.0))),
    "too short": record(command=short(GOOD["command"]), measurement=short(GOOD["measurement"])),
    "no number": record(measurement=replace(GOOD["measurement"], values=np.where(MOVING > 20.0, np.nan, MOVING))),
    "missing topic": record(measurement=None),
}


@pytest.mark.parametrize("case", BAD)
def test_a_record_that_cannot_be_used_is_refused_in_one_line(case, tmp_path, capsys):
    write_bag(tmp_path / "bag", BAD[case])
    refused([str(tmp_path / "bag")], tmp_path, capsys)


def test_an_effect_that_is_none_is_refused_in_one_line(tmp_path, capsys):
    write_bag(tmp_path / "bag", record())
    assert "is not an effect" in refused([str(tmp_path / "bag"), "--without", "gremlins"], tmp_path, capsys)


def test_a_bag_that_is_none_is_refused_in_one_line(tmp_path, capsys):
    assert "nothing_here" in refused([str(tmp_path / "nothing_here")], tmp_path, capsys)


def refused(arguments: list[str], folder, capsys) -> str:
    outputs = [folder / name for name in ("gap.json", "gap.html", "better.yaml")]
    status = hyst(
        [
            "diagnose",
            *arguments,
            "--quiet",
            "--model",
            str(config_path("models/pea_hampi.yaml")),
            "--json",
            str(outputs[0]),
            "--report",
            str(outputs[1]),
            "--augmented",
            str(outputs[2]),
        ]
    )
    said = capsys.readouterr().err.strip()
    assert status == 2
    assert said and "\n" not in said
    assert not any(path.exists() for path in outputs)
    return said


def test_a_measurement_that_never_moves_is_refused_from_python_too():
    with pytest.raises(InputError, match="record: the measurement of x never moves"):
        diagnose(
            [record(measurement=replace(GOOD["measurement"], values=np.full((COUNT, 1), 3.0)))],
            load_model(config_path("models/pea_hampi.yaml")),
        )
