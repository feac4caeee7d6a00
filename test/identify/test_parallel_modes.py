# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Play operators before two modes side by side, of which one is weak: simulated here, from the definitions alone."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete, freqs, lfilter

from hyst_control.identify import identify
from hyst_control.identify.solve.pole_zero_pair import pole_zero_pair
from hyst_control.identify.solve.stable_dynamics import Structure
from hyst_control.model_file import simulate
from hyst_control.records.record import sampled_record

RATE, WEAK = 5000.0, (184.0, 0.014)


def answer(motion: np.ndarray, frequency: float, damping: float) -> np.ndarray:
    w = 2 * np.pi * frequency
    num, den, _ = cont2discrete(([w * w], [1.0, 2 * damping * w, w * w]), 1.0 / RATE, "foh")
    return lfilter(num.ravel(), den, motion)


def plant(command: np.ndarray, seed: int) -> np.ndarray:
    """Four plays from rest at 0 V, then 0.8 of a mode at 73 Hz and 0.2 of one at 184 Hz, two samples late; noise of 0.02 % of the range."""
    thresholds, state, motion = np.array([6.0, 15.0, 25.0, 40.0]), np.zeros(4), np.empty(len(command))
    for row, u in enumerate(command):
        state = np.maximum(u - thresholds, np.minimum(u + thresholds, state))
        motion[row] = 0.6 * u + 0.1 * state.sum()
    moved = 0.8 * answer(motion, 73.0, 0.29) + 0.2 * answer(motion, *WEAK)
    return np.concatenate([[0.0, 0.0], moved[:-2]]) + 0.02 * np.random.default_rng(seed).standard_normal(len(command))


def excitation(seed: int) -> np.ndarray:
    """Two loops, lines up to 500 Hz around the middle, and steps."""
    rng, time = np.random.default_rng(seed), np.arange(4000) / RATE
    loops = 50.0 - 50.0 * np.cos(2 * np.pi * 2.5 * time)
    lines = np.geomspace(5.0, 500.0, 24)
    wave = sum(np.sin(2 * np.pi * f * time + p) for f, p in zip(lines, rng.uniform(0.0, 6.28, 24), strict=True))
    steps = np.repeat(rng.uniform(10.0, 90.0, 10), 400)
    rise = np.minimum(time / 0.1, 1.0)
    return np.concatenate([loops, 50.0 * rise + 20.0 * rise * wave / np.abs(wave).max(), steps])


@pytest.mark.parametrize("family", ["hapi", "hampi"])
def test_a_weak_mode_beside_a_strong_one_is_found(family):
    command = excitation(0)
    record = sampled_record("stage", command[:, None], plant(command, 0)[:, None], 1.0 / RATE, ("x",), "um")
    found = identify([record], family)
    den = next(stage.den for stage in found.model.chain.stages if stage.name == "transfer_function")
    poles = np.roots(den)
    weak = poles[np.argmin(np.abs(np.abs(poles) / (2 * np.pi) - WEAK[0]))]
    assert abs(weak) / (2 * np.pi) == pytest.approx(WEAK[0], rel=0.01) and -weak.real / abs(weak) == pytest.approx(WEAK[1], rel=0.2)
    other = excitation(1)
    error = simulate(found.model, other[:, None])[:, 0] - plant(other, 1)
    assert np.std(error) < 0.004 * np.ptp(plant(other, 1))


@pytest.mark.parametrize("lower", [True, False])
@pytest.mark.parametrize("slow", [False, True])
def test_a_pair_changes_nothing_until_its_pole_and_zero_part(lower, slow):
    smaller = Structure(modes=1, lags=1, zeros=1, slow_pair=slow, delay=True)
    parameters = np.array([np.log(900.0), np.log(0.1), np.log(4000.0), 0.3, *([np.log(8.0), 0.02] * slow), 0.5])
    structure, vector = pole_zero_pair(smaller, parameters, 40.0 if lower else 900.0, 0.05)
    w = np.geomspace(1.0, 1e5, 60)
    before, after = (freqs(*of.rational(at), w)[1] for of, at in ((smaller, parameters), (structure, vector)))
    assert structure.modes == 2 and structure.zeros == 3 and structure.tau(vector) == smaller.tau(parameters)
    np.testing.assert_allclose(after, before, rtol=1e-9)
