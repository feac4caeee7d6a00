# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The search that fits chains to records: its steps, its constraints, and what it must never do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import LinearConstraint, minimize

from hyst_control.chain import Chain, Sampling
from hyst_control.chain.hysteresis.madelung import Madelung
from hyst_control.chain.hysteresis.prandtl_ishlinskii import PlayOperator
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.chain.memoryless import Gain
from hyst_control.identify.data.fit_windows import short_stretches
from hyst_control.identify.data.reversal_points import surviving_turns
from hyst_control.identify.solve.gram_sums import Window
from hyst_control.identify.solve.simulation_error import (
    Parametrization,
    SimulationError,
    constrained_minimum,
    minimize_simulation_error,
)

TS = 1e-3


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), size=st.integers(1, 6), count=st.integers(0, 8))
def test_the_constrained_minimum_is_that_of_a_general_solver(seed, size, count):
    random = np.random.default_rng(seed)
    root = random.normal(size=(size + 2, size))
    normal, gradient = root.T @ root + 0.1 * np.eye(size), random.normal(size=size)
    lhs = random.normal(size=(count, size))
    inside = random.normal(size=size)
    rhs = lhs @ inside - random.random(count)
    found = constrained_minimum(normal, gradient, lhs, rhs)
    assert np.all(lhs @ found >= rhs - 1e-9)

    def cost(x):
        return 0.5 * x @ normal @ x - gradient @ x

    constraints = [LinearConstraint(lhs, rhs, np.inf)] if count else []
    general = minimize(cost, inside, jac=lambda x: normal @ x - gradient, method="SLSQP", constraints=constraints)
    assert cost(found) <= cost(general.x) + 1e-6 * (1 + abs(cost(general.x)))


@settings(max_examples=100, deadline=None)
@given(before=st.lists(st.integers(0, 20), min_size=1, max_size=40), after=st.lists(st.integers(0, 20), min_size=1, max_size=10))
@pytest.mark.parametrize("stage", [Madelung([0.2, 0.5, 0.3], [-0.3, -0.2, 1.5], 20.0, 1.0), PlayOperator(2.5)])
def test_the_surviving_turns_are_all_that_is_remembered(stage, before, after):
    """The whole past and its surviving turning points lead to the same future."""
    history = np.array([0, *before], dtype=float)
    kept = history[surviving_turns(history)]
    futures = []
    for past in (history, kept):
        running = Chain((stage,)).filter(Sampling(TS, 1))
        running.settle(np.zeros(1))
        running.process(past[:, None])
        futures.append(running.process(np.array(after, dtype=float)[:, None]))
    np.testing.assert_allclose(futures[1], futures[0], atol=1e-12)
    assert len(kept) <= len(history) and kept[-1] == history[-1]


def record(rows: int = 4000, seed: int = 1, hold: str = "zoh", noise: float = 0.0) -> Window:
    """A second-order system of gain 2 driven by a wandering command, with an offset and a drift."""
    random = np.random.default_rng(seed)
    command = np.cumsum(random.normal(size=rows))
    running = Chain((Gain(2.0), TransferFunction([4e4], [1.0, 100.0, 4e4]))).filter(Sampling(TS, 1, hold))
    first = running.settle(command[:1])
    simulated = running.process(command[:, None])[:, 0]
    if hold == "zoh":
        simulated = np.append(first, simulated[:-1])
    drift = 3.0 + 0.5 * (np.arange(rows) / rows - 0.5)
    return Window(command, simulated + drift + noise * random.normal(size=rows), TS, hold, 0, 0)


def stages(vector):
    gain, w, damping = vector[0], 100 * np.exp(vector[1]), np.exp(vector[2])
    return [Gain(gain), TransferFunction([w**2], [1.0, 2 * damping * w, w**2])]


FREE = Parametrization(stages, np.zeros((0, 3)), np.zeros(0))
TRUTH = np.array([2.0, np.log(2.0), np.log(0.25)])


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_it_finds_the_parameters_and_the_nuisances(hold):
    found = minimize_simulation_error(
        [record(hold=hold)], FREE, np.array([1.0, 0.0, -1.0]), passes=40, tolerance=1e-12, everything=True
    )
    np.testing.assert_allclose(found.parameters, TRUTH, atol=1e-6)
    np.testing.assert_allclose(found.nuisances, [3.0, 0.5], atol=1e-4)
    assert found.fitted < 1e-10


def test_the_covariance_is_the_scatter_of_repeated_experiments():
    """Thirty records with noise of their own: the mean estimated standard error is the spread of the estimates."""
    fits = [minimize_simulation_error([record(1500, seed=5, noise=0.0)], FREE, TRUTH, passes=2)]
    estimates, errors = [], []
    clean = record(1500, seed=5)
    for seed in range(30):
        noise = 0.5 * np.random.default_rng(seed).normal(size=1500)
        found = minimize_simulation_error(
            [replace(clean, measurement=clean.measurement + noise)], FREE, TRUTH, passes=6, everything=True
        )
        estimates.append(found.parameters)
        errors.append(np.sqrt(np.diag(found.covariance)))
    assert fits[0].fitted < 1e-12
    np.testing.assert_allclose(np.mean(errors, axis=0), np.std(estimates, axis=0), rtol=0.4)


def test_it_is_never_worse_than_its_start_and_keeps_the_constraints():
    window = record(noise=0.1)
    start = np.array([1.5, 0.2, -0.5])
    bound = Parametrization(stages, np.array([[-1.0, 0.0, 0.0]]), np.array([-1.7]))  # gain <= 1.7
    costs = [minimize_simulation_error([window], bound, start, passes=passes, everything=True).fitted for passes in (1, 3, 30)]
    assert costs[0] >= costs[1] >= costs[2]
    final = minimize_simulation_error([window], bound, start, passes=30, everything=True)
    np.testing.assert_allclose(final.parameters[0], 1.7, rtol=1e-6)


def test_stretches_stand_for_the_record():
    """The derivatives' Gram matrix from stretches is that of the whole record, but for the rows; memory and transients apart."""
    window = record(20_000)
    few = short_stretches([window], 8_000, 0.8, 0.4)
    assert sum(len(part.command) for part in few) < 10_000 and len(few) >= 5
    for part in ([window], few):
        assert SimulationError(part, FREE).visit(TRUTH).fitted < 1e-6


def test_stretches_hold_the_rows_in_which_a_sweep_passes_its_highest_frequencies():
    """Slow loops of 95 % of the record, then a sweep: even stretches of this length miss most of its modes."""
    slow, fast = np.linspace(0.0, 10.0, 95_000), np.linspace(0.0, 1.0, 5_000)
    command = np.concatenate([50.0 * np.sin(2 * np.pi * slow), 5.0 * np.sin(2 * np.pi * 400.0 * fast**2)])
    window = Window(command, np.arange(100_000.0), TS, "zoh", 0, 0)
    few = short_stretches([window], 10_000, 600 * TS, 0.0)
    rows = np.concatenate([part.measurement for part in few])
    assert len(rows) == len(np.unique(rows)) < 12_000
    assert np.isin(np.arange(97_000.0, 100_000.0), rows).all()


def test_the_error_over_all_rows_leaves_out_each_records_own_zero_and_drift():
    random = np.random.default_rng(7)
    problem = Parametrization(lambda vector: [Gain(float(vector[0]))], np.zeros((0, 1)), np.zeros(0))
    windows, left = [], 0.0
    for group, offset in enumerate((0.3, -2.0)):
        command, time = random.normal(size=4000), np.linspace(0.0, 1.0, 4000)
        measurement = 2.0 * command + offset + 0.1 * time
        windows.append(Window(command, measurement, TS, "foh", 0, group))
        error = measurement - 1.5 * command
        left += np.mean((error - np.polyval(np.polyfit(time, error, 1), time)) ** 2) / 2.0
    assert SimulationError(windows, problem).visit(np.array([2.0])).fitted < 1e-12
    assert SimulationError(windows, problem).visit(np.array([1.5])).fitted == pytest.approx(left, rel=1e-3)  # the drift has a prior


def test_a_record_that_begins_amid_a_motion_teaches_the_same():
    """The first rows cut off, the dynamics are in motion: their unknown state is a session effect, as the offset is."""
    whole = record(3000, noise=0.01)
    cut = replace(whole, command=whole.command[777:], measurement=whole.measurement[777:])
    start = np.array([1.0, 0.0, -1.0])
    fits = [
        minimize_simulation_error([cut], FREE, start, passes=40, tolerance=1e-12, everything=True, unknown_state=known)
        for known in (False, True)
    ]
    assert fits[1].fitted < 1.02e-4 < 10 * fits[1].fitted < fits[0].fitted
    np.testing.assert_allclose(fits[1].parameters, TRUTH, atol=1e-3)


def test_an_absolute_position_millions_of_times_the_motion_costs_no_digit():
    """A constant in the measurement is the session's: taken away before squaring, it leaves the fit as it was."""
    near = record(noise=0.1)
    far = replace(near, measurement=near.measurement + 1e6 * np.ptp(near.measurement))
    start = np.array([1.0, 0.0, -1.0])
    fits = [minimize_simulation_error([window], FREE, start, passes=40, tolerance=1e-12, everything=True) for window in (near, far)]
    np.testing.assert_allclose(fits[1].parameters, fits[0].parameters, atol=1e-6)
    assert fits[1].fitted == pytest.approx(fits[0].fitted, rel=1e-6)
    assert fits[1].nuisances[0] - fits[0].nuisances[0] == pytest.approx(1e6 * np.ptp(near.measurement), rel=1e-9)
