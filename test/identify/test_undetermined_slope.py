# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A slope that a record hardly shows stays near the mean slope, however much a machine of another kind leaves over."""

import numpy as np
from scipy.signal import cont2discrete, lfilter

from hyst_control.identify import identify
from hyst_control.records.record import sampled_record


def relays(command: np.ndarray) -> np.ndarray:
    """Motion of 1500 relays beside a bent curve, after loops of 100 V: no sum of play operators."""
    rng = np.random.default_rng(1)
    centre, half = rng.normal(42.0, 26.0, 1500), np.abs(rng.normal(7.0, 5.0, 1500) * (1.0 + 0.25 * rng.normal(size=1500)))
    share = np.exp(-0.5 * ((centre - 50.0) / 34.0) ** 2)
    state = np.where((centre - half > 0.0) & (centre + half <= 100.0), 1.0, -1.0)
    memory = np.empty(len(command))
    for row, u in enumerate(command):
        state[u >= centre + half], state[u <= centre - half] = 1.0, -1.0
        memory[row] = share @ state / share.sum()
    return 0.075 * command + 1e-4 * command**2 + 2.0 * (memory - memory[0])


def test_a_slope_that_hardly_any_row_shows_is_not_made_up():
    """The widest operator moves on a few rows at the first peak only. The machine's own way over the range says what its slope may be."""
    step, rows = 1e-4, 10000
    t = step * np.arange(rows)
    command = 50.0 * np.exp(-1.4 * t) * (1.0 - np.cos(2.0 * np.pi * 10.5 * t))
    omega = 2.0 * np.pi * 780.0
    num, den, _ = cont2discrete(([omega**2], [1.0, 0.04 * omega, omega**2]), step, "zoh")
    motion = lfilter(num[0], den, relays(command)) + np.random.default_rng(0).normal(0.0, 0.003, rows)
    data = sampled_record("falling", command[:, None], motion[:, None], step, ("x",), "um", start="unknown")
    hysteresis = identify([data], "hampi", structure="modes=1").model.chain.stages[0]
    slopes = np.cumsum(hysteresis.weights)
    steepest = np.max(np.abs(np.diff(motion[::50]) / np.maximum(np.abs(np.diff(command[::50])), 1.0)))
    assert np.all(slopes < steepest)
