# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Variable projection: the few nonlinear parameters of G(s) by damped Gauss-Newton, everything else by linear least squares."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from hyst_control.base.arrays import Array
from hyst_control.identify.solve import gauss_newton
from hyst_control.identify.solve.bounded_least_squares import cost, solve_bounded
from hyst_control.identify.solve.gauss_newton import Rules, Trial
from hyst_control.identify.solve.gram_sums import Grams, Operators, Window, gram_matrices
from hyst_control.identify.solve.parameter_covariance import PRIOR as KNOWN
from hyst_control.identify.solve.stable_dynamics import Structure

PRIOR = 1e-7  # Least weight of the prior on the slopes, relative to the strongest regressor
RESONANT = 1.5  # Ratio of the mean slope to the gain that fits best, from which the measurement's range is that of a resonance
MIN_SLOPE = 1e-3  # Smallest slope of a branch, relative to the mean slope


@dataclass(frozen=True)
class Problem:
    """One axis of all records, the operators, and the bounds of the linear parameters.

    The bounds are those of the *slopes*, the cumulative sums of the weights: a loop whose every branch rises has positive slopes,
    and only then an inverse.
    """

    windows: Sequence[Window]  # Stretches of the records
    operators: Operators  # The play operators
    nuisance: str  # Nuisance of each record, one of `NUISANCES`
    groups: int  # Number of records
    mean_slope: float  # Range of the measurement / range of the command
    # Largest drift of each record (measurement unit), where the nuisance is linear; no bound where there is none
    drift: Sequence[float] = ()

    @property
    def to_weights(self) -> Array:
        """Matrix (J, J) from the bounded coordinates (slopes; m1, m2, k as they are) to the linear parameters."""
        n = len(self.operators.thresholds)
        matrix = np.eye(self.operators.columns)
        after = np.arange(1, self.operators.weights)
        after = after[after != n]  # the first weight at the upper end of the command's range
        matrix[after, after - 1] = -1.0
        return matrix

    def bounds(self, free: int) -> tuple[Array, Array]:
        """Bounds of the bounded coordinates and of the nuisances, of which only drifts are bounded."""
        weights = self.operators.weights
        rest = [0.0, 0.0, -np.inf][: self.operators.columns - weights]
        lower = np.concatenate([np.full(weights, MIN_SLOPE * self.mean_slope), rest, np.full(free, -np.inf)])
        upper = np.full(len(lower), np.inf)
        if self.nuisance == "linear" and len(self.drift) and free:
            lower[self.operators.columns + 1 :: 2], upper[self.operators.columns + 1 :: 2] = np.negative(self.drift), self.drift
        return lower, upper


@dataclass(frozen=True)
class Solution:
    """Solution of a variable-projection fit."""

    structure: Structure  # Factors of G(s)
    parameters: Annotated[Array, "P"]  # Parameters (P,) of G
    theta: Annotated[Array, "J"]  # Linear parameters (J,)
    nuisances: Array  # Nuisances of the records
    # fitted, held_out: Mean square errors on the rows fitted and held out
    fitted: float
    held_out: float
    grams: Grams  # Gram matrices of the last pass


def linear_solution(problem: Problem, gram: Annotated[Array, "K K"], size: int, blocks: float) -> tuple[Array, Array]:
    """Solve for the linear parameters of the G at which a Gram matrix was formed.

    A slope that the data do not show stays at the mean slope or, in a resonant record, whose measurement moves more, at the gain that
    fits best behind this G. What a model misses of its machine is alike throughout a block of rows, and a slope that removes a little of
    it on a few rows is not shown by them: a block counts as one observation, with the misfit of the best slopes as its variance, against
    `KNOWN` of the mean slope. Without a misfit the prior is far weaker than any data.
    """
    columns = problem.operators.columns
    total = len(gram) - 1
    keep = np.r_[0:columns, columns + size : total]
    transform = np.eye(len(keep))
    transform[:columns, :columns] = problem.to_weights
    reduced = transform.T @ gram[np.ix_(keep, keep)] @ transform
    target = transform.T @ gram[keep, total]
    bounds = problem.bounds(len(keep) - columns)
    slopes = np.arange(len(keep)) < problem.operators.weights
    line = np.column_stack([slopes, np.eye(len(keep))[:, columns:]])
    free = np.full(line.shape[1], np.inf)
    gain = max(float(solve_bounded(line.T @ reduced @ line, line.T @ target, -free, free)[0]), MIN_SLOPE * problem.mean_slope)
    usual = gain if problem.mean_slope > RESONANT * gain else problem.mean_slope

    def solution(strength: float) -> Array:
        prior = strength * slopes
        return transform @ solve_bounded(reduced + np.diag(prior), target + prior * usual, *bounds)

    least = PRIOR * float(np.max(np.diag(reduced)[slopes]))
    misfit = cost(gram[np.ix_(np.r_[keep, total], np.r_[keep, total])], solution(least)) / blocks
    found = solution(max(least, misfit / (KNOWN * problem.mean_slope) ** 2))
    return found[:columns], found[columns:]


def solve(
    problem: Problem,
    structure: Structure,
    start: Annotated[Array, "P"],
    theta: Array | None = None,
    passes: int = 15,
    tolerance: float = 1e-4,
    everything: bool = False,
) -> Solution:
    """Fit G's parameters by damped Gauss-Newton, everything else by linear least squares.

    The derivatives by G's parameters are taken at the linear parameters of the pass before.
    """
    search = _Search(problem, structure, everything)
    present = structure.limit(start, search.sample_time)
    best = search.visit(present, np.zeros(problem.operators.columns) if theta is None else theta)
    if not structure.size:
        return best
    if theta is None and passes > 1:  # derivatives are those at known weights
        best = search.visit(present, best.theta)
    rules = Rules(
        damping=1e-3,
        raised=lambda damping: damping * 10.0,
        eased=lambda damping: max(0.2 * damping, 1e-9),
        small=lambda before, after: 1.0 - after / before < tolerance,
        trials=passes - (2 if theta is None else 1),
        min_move=1e-6,
    )
    return gauss_newton.minimize(search, best, rules).point


@dataclass(frozen=True)
class _Search:
    """The least-squares problem of `solve`; a point is a `Solution`, linearized by the pass that found its linear parameters."""

    problem: Problem
    structure: Structure
    everything: bool

    @property
    def sample_time(self) -> float:
        return min(window.sample_time for window in self.problem.windows)

    def visit(self, parameters: Array, theta: Array) -> Solution:
        problem, structure = self.problem, self.structure
        grams = gram_matrices(problem.windows, problem.operators, structure, parameters, theta, problem.nuisance, problem.groups)
        gram = grams.fitted + grams.held_out if self.everything else grams.fitted
        rows = sum(grams.rows) if self.everything else grams.rows[0]
        blocks = max(len(grams.blocks) * rows / sum(grams.rows), 1.0)
        found, nuisances = linear_solution(problem, gram, structure.size, blocks)
        vector = np.concatenate([found, np.zeros(structure.size), nuisances])
        return Solution(
            structure,
            parameters,
            found,
            nuisances,
            cost(gram, vector) / max(rows, 1),
            cost(grams.held_out, vector) / max(grams.rows[1], 1),
            grams,
        )

    def cost(self, point: Solution) -> float:
        return point.fitted

    def linearize(self, point: Solution) -> Solution:
        return point

    def step(self, point: Solution, damping: float) -> Trial[Solution]:
        step = _limited_step(self.problem, point, self.everything, damping, self.sample_time)
        trial = self.visit(self.structure.limit(point.parameters + step, self.sample_time), point.theta)
        return Trial(trial, float(np.max(np.abs(trial.parameters - point.parameters))))


def _limited_step(problem: Problem, at: Solution, everything: bool, damping: float, sample_time: float) -> Array:
    """The damped Gauss-Newton step; parameters at a bound that it would cross are held there."""
    gram = at.grams.fitted + at.grams.held_out if everything else at.grams.fitted
    free = np.ones(at.structure.size, dtype=bool)
    while True:
        step = np.zeros(len(free))
        step[free] = np.clip(_newton_step(problem, gram, at, np.flatnonzero(free), damping), -0.7, 0.7)
        moved = at.structure.limit(at.parameters + step, sample_time) - at.parameters
        stuck = free & (np.abs(step) > 1e-9) & (np.abs(moved) < 1e-12)
        if not stuck.any() or stuck.sum() == free.sum():
            return step
        free &= ~stuck


def _newton_step(problem: Problem, gram: Array, at: Solution, free: NDArray[np.intp], damping: float) -> Array:
    """Step of G's parameters `free`; linear parameters follow it, except those held at a bound, which stay there."""
    columns, size, extra = len(at.theta), at.structure.size, len(at.nuisances)
    residual = gram[:-1, -1] - gram[:-1, :-1] @ np.concatenate([at.theta, np.zeros(size), at.nuisances])
    # The linear parameters that can move, as directions in the coordinates of the Gram matrix.
    bounded = np.concatenate([np.linalg.solve(problem.to_weights, at.theta), at.nuisances])
    lower, upper = problem.bounds(extra)
    near = 1e-9 * np.max(np.abs(bounded))
    moving = (bounded > lower + near) & (bounded < upper - near)
    followers = np.zeros((len(residual), columns + extra))
    followers[:columns, :columns] = problem.to_weights
    followers[columns + size :, columns:] = np.eye(extra)
    followers = followers[:, moving]
    dynamic = columns + free
    cross = followers.T @ gram[:-1, dynamic]
    inner = followers.T @ gram[:-1, :-1] @ followers
    scale = np.sqrt(np.maximum(np.diag(inner), 1e-300))
    projected = np.linalg.lstsq(inner / scale[:, None] / scale, cross / scale[:, None], rcond=1e-11)[0] / scale[:, None]
    normal = gram[np.ix_(dynamic, dynamic)] - cross.T @ projected
    gradient = residual[dynamic] - projected.T @ (followers.T @ residual)
    diagonal = np.maximum(np.diag(normal), 1e-12 * np.max(np.diag(normal)) + 1e-300)
    return np.linalg.solve(normal + damping * np.diag(diagonal), gradient)
