# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Exam on machines of other people: the rule of a right answer, and what the command says without their records."""

from __future__ import annotations

import numpy as np
import pytest

from evaluation.reproduction import exam
from evaluation.reproduction.exam import Case, Machine, Truth, is_right
from hyst_control.api.record import from_arrays
from hyst_control.base.errors import InputError
from hyst_control.chain.chain import Chain
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.model_file import Model, simulate

ONE_SIDED = Truth(("saturation",), {"memory": False, "even": True}, one_side=True)


def report(verdict: str, name: str = "", structure: dict | None = None, **limits: float | None) -> dict:
    rows = [{"question": question, "probability": value} for question, value in (structure or {}).items()]
    effects = [{"name": name, "parameters": {key: {"value": value} for key, value in limits.items()}}] if name else []
    return {"verdict": verdict, "effects": effects, "structure": rows}


def test_the_rule():
    assert is_right(ONE_SIDED, report("effect", "saturation", lower=None, upper=2.0))
    assert not is_right(ONE_SIDED, report("effect", "saturation", lower=-1.0, upper=2.0))
    assert not is_right(ONE_SIDED, report("ambiguous", "gain", gain=0.1))
    assert is_right(ONE_SIDED, report("unknown", "saturation", {"memory": 0.2, "even": 0.9}, lower=-1.0, upper=2.0))
    assert not is_right(ONE_SIDED, report("unknown", structure={"memory": 0.2, "even": 0.4}))
    assert not is_right(ONE_SIDED, report("unknown"))
    assert not any(is_right(ONE_SIDED, report(verdict)) for verdict in ("no_gap", "parameters"))


def test_without_the_records_the_command_says_what_is_missing(monkeypatch, tmp_path):
    monkeypatch.setenv("HYST_DATA", str(tmp_path))
    with pytest.raises(InputError, match="exam: the measurements are not in"):
        exam.run()


@pytest.mark.parametrize("text", ["", "u,y\n", "u,y\n1\n", "u,y\n1,2\n3\n"])
def test_a_table_that_is_cut_off_is_refused(monkeypatch, tmp_path, text):
    (tmp_path / "tanks.csv").write_text(text, encoding="utf-8")
    monkeypatch.setattr(exam, "data_folder", lambda _: tmp_path)
    with pytest.raises(InputError, match=r"tanks.csv: cannot be read .*: fetch the file again"):
        exam.tanks()


def test_a_machine_with_dry_friction_passes():
    """Made here by small steps of its equation of motion; the model has another damping and no friction."""
    rate, time = 200.0, np.arange(1600) / 200.0
    drive = 2.0 * np.sin(2 * np.pi * 0.7 * time) + 1.2 * np.sin(2 * np.pi * 1.9 * time + 1.0)
    speed, found = 0.0, [0.0]
    for value in drive[:-1]:
        for _ in range(20):
            free = speed + 1.0 / rate / 20 * (360.0 * value - 2.0 * speed)
            speed = np.sign(free) * max(abs(free) - 1.0 / rate / 20 * 216.0, 0.0)
        found.append(speed)
    noise = 0.5 * np.random.default_rng(3).standard_normal(len(found))
    drive[0] = 0.0
    model = Model(
        "carriage",
        ("x",),
        {"command": "V", "measurement": "mm/s"},
        1.0 / rate,
        Chain((TransferFunction([360.0], [1.0, 2.0]),)),
        tolerance={"num": 0.05, "den": 0.05},
    )
    assert np.std(simulate(model, drive[:, None])[:, 0] - found) > 20.0
    record = from_arrays(drive, np.array(found) + noise, rate, command_unit="V", unit="mm/s")
    machine = Machine("carriage", Truth(("dry_friction",)), lambda: Case(model, record, own_records=True))
    table = exam.run(machines=[machine])
    assert [row.value for row in table.rows if row.quantity == "right"] == [1.0, 1.0]
