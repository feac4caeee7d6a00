# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Play operators before a mode that rings for many samples, sampled slowly: simulated here, from the definitions alone."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from hyst_control.identify import identify
from hyst_control.identify.data.initial_memory import FILLED, estimated_memory
from hyst_control.identify.solve.stable_dynamics import pace
from hyst_control.records.record import sampled_record

THRESHOLDS, WEIGHTS, W0 = np.array([4.0, 9.0, 14.0, 25.0, 36.0]), np.array([0.08, 0.06, 0.07, 0.1, 0.11]), 0.45


def play(command: np.ndarray) -> np.ndarray:
    """Play operators from rest at 0 V."""
    state, found = np.zeros(len(THRESHOLDS)), np.empty(len(command))
    for row, u in enumerate(command):
        state = np.maximum(u - THRESHOLDS, np.minimum(u + THRESHOLDS, state))
        found[row] = W0 * u + WEIGHTS @ state
    return found


def measured(command: np.ndarray, rate: float, frequency: float, damping: float, late: int, sigma: float) -> np.ndarray:
    """The motion behind a mode and a delay, from rest at the first command, with white noise."""
    w = 2 * np.pi * frequency
    num, den, _ = cont2discrete(([w * w], [1.0, 2 * damping * w, w * w]), 1.0 / rate)
    motion = play(command)
    moved = lfilter(num.ravel(), den, np.concatenate([np.full(4000, motion[0]), motion]))[4000 - late : len(motion) + 4000 - late]
    return moved + sigma * np.random.default_rng(0).standard_normal(len(command))


def fitted(command: np.ndarray, values: np.ndarray, rate: float):
    return identify([sampled_record("slow", command[:, None], values[:, None], 1.0 / rate, ("x",), "um", start="auto")], "hapi")


def staircase(rows: int, held: int) -> np.ndarray:
    return np.repeat(np.random.default_rng(3).uniform(0.0, 100.0, rows // held + 1), held)[:rows]


def test_a_mode_that_a_staircase_rings_and_a_delay_of_samples_are_found():
    command = staircase(6000, 230)
    values = measured(command, 900.0, 55.0, 0.026, 3, 0.2)
    found = fitted(command, values, 900.0)
    den = found.model.chain.stages[-2 if found.model.chain.stages[-1].name == "offset" else -1].den
    poles = np.roots(den)
    mode = poles[np.argmin(np.abs(np.abs(poles) / (2 * np.pi) - 55.0))]
    late = sum(stage.tau for stage in found.model.chain.stages if stage.name == "delay")
    assert abs(mode) / (2 * np.pi) == pytest.approx(55.0, rel=0.005) and -mode.real / abs(mode) == pytest.approx(0.026, rel=0.05)
    assert late == pytest.approx(3 / 900.0, abs=0.2 / 900.0)
    assert found.report["records"][0]["nrmse_own_zero"] / 100.0 * np.ptp(values) < 1.1 * 0.2


def test_a_record_that_rose_from_zero_before_it_begins_is_followed_from_its_first_row():
    time = np.arange(9000) / 280.0
    wave = sum(np.sin(2 * np.pi * f * time + p) for f, p in zip((0.06, 0.2, 0.65, 1.7), (0.3, 2.0, 4.0, 5.5), strict=True))
    command = 50.0 + 50.0 * wave / np.abs(wave).max()
    values = measured(command, 280.0, 9.0, 0.045, 0, 0.02)
    report = fitted(command, values, 280.0).report
    assert report["beginnings"][0]["assumed"] != FILLED or report["beginnings"][0]["first_row"] < 0.5 * len(command)
    assert report["records"][0]["nrmse_own_zero"] < 0.5


@pytest.mark.parametrize("held", [60, 230])
def test_the_memory_of_held_levels_is_told_from_where_the_mode_has_rung_out(held):
    command = staircase(6000, held)
    assert estimated_memory(command, measured(command, 900.0, 55.0, 0.026, 3, 0.2)).turns[0] == 0.0


def test_a_given_structure_is_fitted_where_nothing_of_it_is_excited():
    command = 50.0 + 50.0 * np.sin(2 * np.pi * np.arange(4000) / 4000)
    values = play(command) + 20.0 * np.random.default_rng(1).standard_normal(len(command))
    record = sampled_record("slow", command[:, None], values[:, None], 1e-2, ("x",), "um", start="auto")
    assert identify([record], "hapi", structure="modes=1").model.chain.stages


def test_times_are_looked_for_in_samples_of_slow_records():
    assert pace(5e-5) == pace(1e-4) == 1.0 and pace(1e-2) == pytest.approx(100.0)
