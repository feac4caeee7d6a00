# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A delay of hundreds of samples is found by every family and stands in the model; the plant here is numpy alone."""

from __future__ import annotations

import numpy as np
import pytest

from hyst_control.chain.linear.linear_stages import Delay
from hyst_control.identify.workflow import identify_records
from hyst_control.model_file import simulate
from hyst_control.records.record import Record, Signal

STEP, LATE = 1e-4, 300


def record(late: int, seed: int = 1) -> Record:
    """Loops of play operators before a resonance at 500 Hz, `late` samples late, with noise of 0.01 % of the range."""
    rng = np.random.default_rng(seed)
    time = np.arange(20000) * STEP
    envelope = 40.0 * np.sin(np.pi * time / time[-1])
    frequencies = np.geomspace(2.0, 400.0, 14)
    waves = sum(np.sin(2 * np.pi * f * time + phase) for f, phase in zip(frequencies, rng.uniform(0, 6, 14), strict=True))
    command = 50.0 + envelope * waves / 5.0
    moved = 0.1 * command
    for threshold in (3.0, 8.0, 15.0):
        state = command[0]
        held = np.empty_like(command)
        for row, value in enumerate(command):
            state = min(max(state, value - threshold), value + threshold)
            held[row] = state
        moved += 0.02 * held
    omega, damping = 2 * np.pi * 500.0, 0.05
    position, speed = moved[0], 0.0
    measured = np.empty_like(command)
    for row, value in enumerate(moved):
        measured[row] = position
        for _ in range(20):  # semi-implicit Euler with a twentieth of a sample
            speed += STEP / 20 * (omega**2 * (value - position) - 2 * damping * omega * speed)
            position += STEP / 20 * speed
    measured = np.concatenate([np.full(late, measured[0]), measured])[: len(command)]
    measured += 1e-3 * rng.normal(size=len(command))
    return Record(
        {"command": Signal(time, command[:, None], ("x",), "V"), "measurement": Signal(time, measured[:, None], ("x",), "um")},
        "late",
    )


@pytest.mark.parametrize("family", ["hapi", "hampi"])
def test_a_long_delay_becomes_the_delay_of_the_model(family):
    fit, prompt = (identify_records([record(late)], family) for late in (LATE, 0))
    assert all(np.max(stage.tau) < 1e-3 for stage in prompt.model.chain.stages if isinstance(stage, Delay))
    [delay] = [stage for stage in fit.model.chain.stages if isinstance(stage, Delay)]
    assert float(np.max(delay.tau)) == pytest.approx(LATE * STEP, abs=1e-3)
    left, least = (each.report["records"][0]["nrmse_own_zero"] for each in (fit, prompt))
    assert left < 1.3 * least
    other = record(LATE, seed=2)
    made = simulate(fit.model, other.signal("command").values)
    left = (other.signal("measurement").values - made)[4000:]
    assert np.std(left) < 0.01 * np.ptp(other.signal("measurement").values)
    assert any("late by" in note and "--shift" in note for note in fit.report["notes"])
    assert any(row["unit"] == "s" and row["value"] == pytest.approx(LATE * STEP, abs=1e-3) for row in fit.report["parameters"])
