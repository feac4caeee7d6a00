# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Damped Gauss-Newton, the iteration of all fits.

A problem defines a point (parameters, and data for the next step, such as Gram sums), its cost, and the step that its
linearization suggests; this module decides which steps are kept, how the damping follows, and when the search ends (Levenberg,
Quarterly of Applied Mathematics 2, 1944; Marquardt, SIAM Journal 11, 1963). It holds no arithmetic of a fit.

The damping is a number that only the problem interprets. A search that shortens its steps along a ladder, in place of damping them,
counts with it: `Rules(damping=0, raised=lambda rung: rung + 1, eased=lambda rung: 0, rejections=len(ladder))`, its `step` takes
`ladder[int(damping)]` of the undamped step, gives an infinite cost to a point that no chain accepts, and is None where the linear model
predicts no improvement.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Generic, Protocol, TypeVar

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from hyst_control.base.arrays import Array, Mask

P = TypeVar("P")


@dataclass(frozen=True)
class Trial(Generic[P]):
    """A point that a step leads to."""

    point: P
    moved: float = math.inf  # Largest change of a parameter on the way


class Problem(Protocol[P]):
    """A nonlinear least-squares problem. Points are values: a step that is not kept leaves nothing behind."""

    def cost(self, point: P) -> float:
        """Return the cost of a `point`, which the search lowers."""

    def linearize(self, point: P) -> P:
        """Return the point with the derivatives there; called only where another step begins."""

    def step(self, point: P, damping: float) -> Trial[P] | None:
        """Return the trial of the step with `damping` from a linearized `point`; None where no step is worth a trial."""


class End(Enum):
    """Reason for which a search ended."""

    BUDGET = "largest number of steps or trials reached"
    SMALL_GAIN = "the last step gained little"
    NO_STEP = "no step lowers the cost"


@dataclass(frozen=True)
class Rules:
    """Rules of a search."""

    damping: float  # Of the first step
    raised: Callable[[float], float]  # Damping after a step that is rejected
    eased: Callable[[float], float]  # Damping after one that is kept
    small: Callable[[float, float], bool]  # Whether the gain from a cost (first) to the next (second) is a sign of the minimum
    confident: float = math.inf  # Damping from which on a small gain is no such sign: under strong damping it is not significant
    steps: float = math.inf  # Most steps kept
    trials: float = math.inf  # Most steps tried
    rejections: float = math.inf  # Most rejections in a row
    highest: float = math.inf  # A rejected step of more damping is the last
    min_move: float = 0.0  # A rejected step whose parameters all move by less is the last


@dataclass(frozen=True)
class Found(Generic[P]):
    """Best point of a search."""

    point: P
    end: End  # Reason for the end of the search
    steps: int  # Number of steps kept
    trials: int  # Number of steps tried
    linearized: bool  # True if the point's derivatives were taken there, False if one step before


def minimize(problem: Problem[P], start: P, rules: Rules) -> Found[P]:
    """Lower the cost of a problem from a linearized start; never worse than the start, and without derivatives after the last step.

    Parameters
    ----------
    problem
        The problem.
    start
        A linearized point.
    rules
        Rules of the search.

    Returns
    -------
    Found[P]
        The best point, with the reason of the end.
    """
    point, damping = start, rules.damping
    kept = tried = rejected = 0
    linearized = True
    while kept < rules.steps and tried < rules.trials:
        if not linearized:
            point, linearized = problem.linearize(point), True
        trial = problem.step(point, damping)
        if trial is None:
            return Found(point, End.NO_STEP, kept, tried, linearized)
        tried += 1
        before, after = problem.cost(point), problem.cost(trial.point)
        if not after < before:
            rejected += 1
            if rejected >= rules.rejections or damping > rules.highest or trial.moved < rules.min_move:
                return Found(point, End.NO_STEP, kept, tried, linearized)
            damping = rules.raised(damping)
            continue
        kept, rejected = kept + 1, 0
        point, linearized = trial.point, False
        damping = rules.eased(damping)
        if rules.small(before, after) and damping < rules.confident:
            return Found(point, End.SMALL_GAIN, kept, tried, linearized)
    return Found(point, End.BUDGET, kept, tried, linearized)


def solve_damped(matrix: Array, vector: Array, chosen: Mask, damping: float) -> Array:
    """Step (P,) of the damped normal equations (J'J + damping · diag J'J) step = J'r over the parameters that may move.

    Parameters
    ----------
    matrix, vector
        J'J (P, P) and J'r (P,).
    chosen
        Mark (P,) of the parameters that may move.
    damping
        Damping, relative to the diagonal.

    Returns
    -------
    ndarray
        The step (P,), 0 where a parameter may not move.
    """
    index = np.flatnonzero(chosen)
    scale = np.sqrt(np.maximum(np.diag(matrix)[index], 1e-300))
    scaled = matrix[np.ix_(index, index)] / scale / scale[:, None]
    scaled[np.diag_indices_from(scaled)] += damping
    step = np.zeros(len(vector))
    try:
        step[index] = cho_solve(cho_factor(scaled), vector[index] / scale) / scale
    except np.linalg.LinAlgError:
        step[index] = np.linalg.lstsq(scaled, vector[index] / scale, rcond=1e-13)[0] / scale
    return step
