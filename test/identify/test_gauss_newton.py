# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The one iteration of every fit: which steps it keeps, when it ends, and that a search that shortens its steps needs no other."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from hyst_control.identify.solve.gauss_newton import End, Rules, Trial, minimize, solve_damped

RULES = Rules(
    damping=1e-3,
    raised=lambda damping: 10 * damping,
    eased=lambda damping: damping / 5,
    small=lambda before, after: before - after <= 1e-14 * before,
    steps=200,
    rejections=20,
)


@dataclass(frozen=True)
class Point:
    """Parameters (P,), and their residual and derivatives where those were taken."""

    x: np.ndarray
    cost: float
    matrix: np.ndarray | None = None
    vector: np.ndarray | None = None


class Curve:
    """Decay a e^(-b t) + c through points; counts how often derivatives are taken."""

    ladder: tuple[float, ...] = ()

    def __init__(self, truth=(2.0, 1.5, 0.3), noise: float = 0.0, seed: int = 0) -> None:
        self.t = np.linspace(0, 3, 40)
        self.y = self.model(np.array(truth)) + noise * np.random.default_rng(seed).normal(size=40)
        self.linearized = 0

    def model(self, x):
        return x[0] * np.exp(-x[1] * self.t) + x[2]

    def residual(self, x):
        return self.y - self.model(x)

    def at(self, x) -> Point:
        with np.errstate(over="ignore"):
            cost = float(np.sum(self.residual(x) ** 2))
        return Point(x, cost if math.isfinite(cost) else math.inf)

    def cost(self, point: Point) -> float:
        return point.cost

    def linearize(self, point: Point) -> Point:
        self.linearized += 1
        a, b, _ = point.x
        decay = np.exp(-b * self.t)
        jacobian = np.stack([decay, -a * self.t * decay, np.ones_like(decay)], axis=1)
        return replace(point, matrix=jacobian.T @ jacobian, vector=jacobian.T @ self.residual(point.x))

    def step(self, point: Point, damping: float) -> Trial[Point] | None:
        if self.ladder:
            move = self.ladder[int(damping)] * np.linalg.lstsq(point.matrix, point.vector, rcond=1e-12)[0]
            if point.vector @ move < 1e-16:
                return None
        else:
            move = solve_damped(point.matrix, point.vector, np.ones(3, dtype=bool), damping)
        return Trial(self.at(point.x + move), float(np.max(np.abs(move))))


def started(problem: Curve, x=(1.0, 0.5, 0.0)) -> Point:
    return problem.linearize(problem.at(np.array(x)))


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 1000), a=st.floats(0.5, 3.0), b=st.floats(0.3, 3.0))
def test_it_finds_the_minimum_of_a_general_solver(seed, a, b):
    problem = Curve((a, b, 0.3), 0.05, seed)
    found = minimize(problem, started(problem), RULES)
    general = least_squares(problem.residual, [1.0, 0.5, 0.0], method="lm", xtol=1e-12, ftol=1e-12)
    assume(general.success and general.x[1] > 0.05)  # the valley of a decay that is nearly a line ends far away
    assert found.point.cost <= 2 * general.cost * (1 + 1e-6)


def test_a_ladder_of_shorter_steps_is_a_damping_too():
    """As the diagnosis' fits do it: undamped steps, halved while they do not help, none where the linear model promises nothing."""
    problem = Curve()
    problem.ladder = (1.0, 0.5, 0.25, 0.1, 0.03)
    rules = replace(RULES, damping=0.0, raised=lambda rung: rung + 1, eased=lambda rung: 0.0, rejections=5)
    found = minimize(problem, started(problem), rules)
    np.testing.assert_allclose(found.point.x, [2.0, 1.5, 0.3], atol=1e-6)
    assert found.end is End.NO_STEP and found.linearized


def test_the_damping_follows_the_steps_and_the_end_has_its_reason():
    asked: list[float] = []

    class Scripted:
        """Costs from a list, one a trial."""

        costs = iter([9.0, 8.0, 8.5, 8.4, 7.0, 6.99])

        def cost(self, point):
            return point

        def linearize(self, point):
            return point

        def step(self, point, damping):
            asked.append(damping)
            return Trial(next(self.costs), 1.0)

    rules = replace(RULES, damping=1.0, small=lambda before, after: 1 - after / before < 0.01)
    found = minimize(Scripted(), 10.0, rules)
    assert asked == pytest.approx([1.0, 0.2, 0.04, 0.4, 4.0, 0.8])
    assert (found.point, found.end, found.steps, found.trials) == (6.99, End.SMALL_GAIN, 4, 6)


@pytest.mark.parametrize(
    "change, end",
    [
        ({"steps": 2}, End.BUDGET),
        ({"trials": 3}, End.BUDGET),
        ({"steps": 0}, End.BUDGET),
        ({"small": lambda before, after: after < 1e-6}, End.SMALL_GAIN),
    ],
)
def test_derivatives_are_taken_only_where_a_step_begins(change, end):
    problem = Curve()
    found = minimize(problem, started(problem), replace(RULES, **change))
    assert found.end is end
    assert problem.linearized == max(found.steps, 1) and found.linearized == (found.steps == 0)


@pytest.mark.parametrize("limit", [{"rejections": 3}, {"highest": 0.05}, {"min_move": 1e3}])
def test_a_start_that_nothing_lowers_is_kept(limit):
    class Bottom(Curve):
        def at(self, x):
            return Point(x, math.nan)

    problem = Bottom()
    start = replace(started(Curve()), cost=1.0)
    found = minimize(problem, start, replace(RULES, **limit))
    assert found.point is start and found.end is End.NO_STEP and found.steps == 0


def test_small_gains_under_strong_damping_are_no_end():
    problem = Curve()
    rules = replace(RULES, damping=1e3, small=lambda before, after: True, confident=1.0)
    found = minimize(problem, started(problem), rules)
    assert found.end is End.SMALL_GAIN and found.steps > 3
    assert minimize(problem, started(problem), replace(rules, confident=math.inf)).steps == 1


def test_only_the_chosen_parameters_move():
    matrix, vector = np.array([[4.0, 1.0], [1.0, 3.0]]), np.array([2.0, 9.0])
    np.testing.assert_allclose(solve_damped(matrix, vector, np.array([True, True]), 0.0), np.linalg.solve(matrix, vector))
    np.testing.assert_allclose(solve_damped(matrix, vector, np.array([False, True]), 0.5), [0.0, 9.0 / 4.5])
    np.testing.assert_allclose(solve_damped(np.zeros((2, 2)), np.zeros(2), np.array([True, True]), 0.0), 0.0)
