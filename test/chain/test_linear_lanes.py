# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Linear systems side by side against their own difference equation, row by row."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from hyst_control.chain.linear.discretization import Discretised
from hyst_control.chain.linear.linear_lanes import GROUPS, TOGETHER, LinearLanes


def drawn(rng: np.random.Generator, states: int) -> Discretised:
    """A stable system whose outputs use all three taps of the state and both of the output."""
    a = rng.normal(size=(states, states))
    if states:
        a *= 0.95 / np.abs(np.linalg.eigvals(a)).max()
    return Discretised(
        a, rng.normal(size=(3, states, 1)), rng.normal(size=(1, states)), rng.normal(size=(2, 1, 1)), rng.normal(size=1)
    )


def by_hand(system: Discretised, late: int, rest: float, signal: np.ndarray) -> np.ndarray:
    """x[k] = A x[k-1] + Σ B[i] w[k-i], y[k] = C x[k] + Σ D[i] w[k-i] + bias, long at rest before the first row."""
    before = 2000
    w = np.concatenate([np.full(before + late + 2, rest), signal])
    x, found = np.zeros(len(system.A)), []
    for k in range(2, len(w) - late):
        x = system.A @ x + sum(system.B[i, :, 0] * w[k - i] for i in range(3))
        found.append(system.C[0] @ x + system.D[0, 0, 0] * w[k] + system.D[1, 0, 0] * w[k - 1] + system.bias[0])
    return np.array(found[before:])


@pytest.mark.parametrize("states", [0, 1, 2, 5])
def test_each_follows_its_own_difference_equation(states: int) -> None:
    """Different delays and inputs; blocks of one row, of a few, and of more than one product holds."""
    rng = np.random.default_rng(states)
    systems, late = [drawn(rng, states) for _ in range(3)], [0, 3, 40]
    signals, rest = rng.normal(size=(3, GROUPS * TOGETHER + 700)), rng.normal(size=3)
    due = np.array([by_hand(*each) for each in zip(systems, late, rest, signals, strict=True)])
    lanes = LinearLanes(systems, late)
    settled = lanes.settle(rest)
    cuts = [0, 1, 30, 130, 133, signals.shape[1]]
    found, table = [], np.full(signals.shape, np.nan)
    for begin, end in zip(cuts, cuts[1:]):
        found.append(lanes.process([signal[begin:end] for signal in signals], table[:, begin:end] if end > 130 else None))
    np.testing.assert_allclose(np.hstack(found), due, rtol=0, atol=1e-11 * np.abs(due).max())
    np.testing.assert_array_equal(table[:, 130:], np.hstack(found)[:, 130:])
    at_rest = [by_hand(system, 0, value, np.full(1, value))[0] for system, value in zip(systems, rest, strict=True)]
    np.testing.assert_allclose(settled, at_rest, rtol=1e-10)


def test_an_input_beyond_all_bounds_warns_nobody() -> None:
    """A fit tries parameters that no chain stands; it sees the output, which is no number, and nothing is printed."""
    system = drawn(np.random.default_rng(7), 2)
    lanes = LinearLanes([replace(system, B=100.0 * system.B)], [0])
    lanes.settle(np.zeros(1))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = lanes.process([np.full(200, 1e308)])
    assert not np.isfinite(found).all()
