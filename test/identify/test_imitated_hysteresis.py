# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Linear dynamics that imitate a hysteresis: the machines are play operators and scipy's filters, written here."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import chirp, lfilter

from hyst_control.chain.linear.linear_stages import Delay
from hyst_control.identify.assess.imitated_hysteresis import imitated_hysteresis
from hyst_control.identify.data.fit import Fit
from hyst_control.identify.workflow import identify_records
from hyst_control.model_file import simulate
from hyst_control.records.record import Record, sampled_record

RATE, ROWS = 2500.0, 4000
TIME = np.arange(ROWS) / RATE
TRIANGLE = 100.0 / np.pi * np.arcsin(np.sin(2 * np.pi * 3.0 * TIME))
COMMANDS = {
    "one triangle": TRIANGLE,
    "shrinking triangles": TRIANGLE * np.linspace(1.0, 0.2, ROWS),
    "sweep": 50.0 * chirp(TIME, 0.5, TIME[-1], 60.0, phi=-90),
}


def with_loops(command: np.ndarray) -> np.ndarray:
    """Eight play operators by their definition; without them the slope is three quarters as steep."""
    reach, outputs = np.linspace(5.0, 40.0, 8), np.zeros((ROWS, 8))
    for row in range(1, ROWS):
        outputs[row] = np.clip(outputs[row - 1], command[row] - reach, command[row] + reach)
    return 0.1 * command + outputs @ np.full(8, 0.004)


def with_creep(command: np.ndarray) -> np.ndarray:
    """Three slow relaxations: loops, too, but of linear dynamics."""
    poles = np.exp(-1.0 / RATE / np.array([0.01, 0.06, 0.4]))
    return 0.1 * command + sum(0.008 * lfilter([0.0, 1.0 - pole], [1.0, -pole], command) for pole in poles)


def measured(kind: str, machine) -> Record:
    turn = np.exp((-0.03 + 1j) * 2 * np.pi * 200.0 / RATE)
    den = np.array([1.0, -2.0 * turn.real, abs(turn) ** 2])
    answer = lfilter([0.0, den.sum()], den, machine(COMMANDS[kind]))
    noisy = answer + 1e-3 * np.ptp(answer) * np.random.default_rng(2).normal(size=ROWS)
    return sampled_record("r", COMMANDS[kind][:, None], noisy[:, None], 1.0 / RATE, ("x",), "um")


@pytest.fixture(scope="module")
def imitating() -> Fit:
    return identify_records([measured("sweep", with_loops)], "linear")


def test_loops_of_play_operators_are_no_matter_of_poles(imitating):
    report = imitating.report
    assert report["explained"][0]["model"] > 0.995, "the poles follow the loops of their own record"
    assert report["verdict"] == "explains_poorly"
    assert any("linear dynamics imitate a hysteresis" in note and "--model hapi" in note for note in report["notes"])


def test_the_loops_come_as_late_as_the_model_says(imitating):
    """Command and measurement 12 rows apart, and a delay of as many in the model."""
    late, record = 12, measured("sweep", with_loops)
    moved = np.concatenate([np.zeros(late), record.measurement[:-late, 0]])[:, None]
    shifted = sampled_record("r", record.command, moved, 1.0 / RATE, ("x",), "um", start="settled")
    model = imitating.model.with_stages([Delay(late / RATE), *imitating.model.chain.stages])
    error = moved - simulate(model, record.command, 1.0 / RATE, record.hold)
    [found] = imitated_hysteresis(model, [shifted], [error])
    assert found.surely and found.beside < 0.7 * found.left


@pytest.mark.parametrize("kind", ["shrinking triangles", "sweep"])
def test_loops_of_slow_poles_are_no_hysteresis(kind):
    fit = identify_records([measured(kind, with_creep)], "linear")
    assert fit.report["verdict"] == "explains"
    assert not any("hysteresis" in note for note in fit.report["notes"])


def test_loops_of_one_size_at_one_rate_do_not_tell():
    report = identify_records([measured("one triangle", with_loops)], "linear").report
    assert any("a hysteresis with loops of" in note or "imitate a hysteresis" in note for note in report["notes"])
