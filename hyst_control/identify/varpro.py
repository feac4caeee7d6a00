"""Variable projection: the few nonlinear parameters of G(s) by damped Gauss-Newton, everything else by linear least squares."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hyst_control.chain.stage import Array
from hyst_control.identify.dynamics import Structure
from hyst_control.identify.gram import Grams, Operators, Window, gram_matrices
from hyst_control.identify.least_squares import cost, solve_bounded

PRIOR = 1e-7
"""Weight of the prior on the slopes, relative to the strongest regressor."""
LEAST_SLOPE = 1e-3
"""Smallest slope of a branch, relative to the mean slope."""


@dataclass(frozen=True)
class Problem:
    """One axis of all records, the operators, and the bounds of the linear parameters.

    The bounds are those of the *slopes*, the cumulative sums of the weights: a loop whose every branch rises has positive
    slopes, and only then an inverse.
    """

    windows: Sequence[Window]
    operators: Operators
    nuisance: str
    groups: int
    mean_slope: float

    @property
    def to_weights(self) -> Array:
        """Matrix (J, J) from the bounded coordinates (slopes; m1, m2, k as they are) to the linear parameters."""
        n = len(self.operators.thresholds)
        matrix = np.eye(self.operators.columns)
        matrix[np.arange(1, n), np.arange(n - 1)] = -1.0
        return matrix

    def bounds(self, free: int) -> tuple[Array, Array]:
        """Bounds of the bounded coordinates followed by `free` unbounded ones."""
        n, dynamic = len(self.operators.thresholds), self.operators.dynamic
        lower = np.concatenate([np.full(n, LEAST_SLOPE * self.mean_slope), [0.0, 0.0, -np.inf] * dynamic, np.full(free, -np.inf)])
        return lower, np.full(len(lower), np.inf)


@dataclass(frozen=True)
class Solution:
    """Parameters of G, linear parameters (J,), nuisances, the mean square errors fitted and held out, and the Gram matrices."""

    structure: Structure
    parameters: Array
    theta: Array
    nuisances: Array
    fitted: float
    held_out: float
    grams: Grams
    passes: int


def linear_solution(problem: Problem, gram: Array, size: int) -> tuple[Array, Array]:
    """θ (J,) and nuisances for the G at which `gram` was formed; `size` dynamics columns are left out."""
    columns = problem.operators.columns
    total = len(gram) - 1
    keep = np.r_[0:columns, columns + size:total]
    transform = np.eye(len(keep))
    transform[:columns, :columns] = problem.to_weights
    reduced = transform.T @ gram[np.ix_(keep, keep)] @ transform
    target = transform.T @ gram[keep, total]
    # Slopes that the data do not show stay at the mean slope: a prior far weaker than any data that do show them.
    count = len(problem.operators.thresholds)
    strength = PRIOR * float(np.max(np.diag(reduced)[:count]))
    reduced[np.arange(count), np.arange(count)] += strength
    target[:count] += strength * problem.mean_slope
    solution = transform @ solve_bounded(reduced, target, *problem.bounds(len(keep) - columns))
    return solution[:columns], solution[columns:]


def solve(problem: Problem, structure: Structure, start: Array, theta: Array | None = None, passes: int = 15,
          tolerance: float = 1e-4, everything: bool = False) -> Solution:
    """Fit G's parameters from `start`. With `everything` the held-out rows are fitted too, for the final model.

    Each pass over the records gives the cost at the present parameters and the Gauss-Newton step from them; a step that did
    not lower the cost is shortened.
    """
    columns, size = problem.operators.columns, structure.size
    sample_time = min(window.sample_time for window in problem.windows)
    present = structure.limit(start, sample_time)
    theta = np.zeros(columns) if theta is None else theta
    best: Solution | None = None
    damping, passed = 1e-3, 0
    while passed < passes:
        grams = gram_matrices(problem.windows, problem.operators, structure, present, theta, problem.nuisance, problem.groups)
        passed += 1
        gram = grams.fitted + grams.held_out if everything else grams.fitted
        found, nuisances = linear_solution(problem, gram, size)
        rows = sum(grams.rows) if everything else grams.rows[0]
        vector = np.concatenate([found, np.zeros(size), nuisances])
        fitted = cost(gram, vector) / max(rows, 1)
        if not np.any(theta) and size:
            theta = found  # the derivatives by G's parameters need a first θ: pass once more at the same parameters
            continue
        if best is not None and not fitted < best.fitted:
            if np.max(np.abs(present - best.parameters)) < 1e-6 or passed == passes:
                break
            present = best.parameters + 0.3 * (present - best.parameters)
            damping = min(damping * 10, 1e6)
            theta = best.theta
            continue
        improvement = np.inf if best is None else 1.0 - fitted / best.fitted
        held_out = cost(grams.held_out, vector) / max(grams.rows[1], 1)
        best = Solution(structure, present, found, nuisances, fitted, held_out, grams, passed)
        theta = found
        if not size or (improvement < tolerance and passed > 2):
            break
        step = _newton_step(problem, gram, vector, size, damping)
        present = structure.limit(present + np.clip(step, -0.7, 0.7), sample_time)
        damping = max(damping * 0.2, 1e-9)
    assert best is not None
    return best


def _newton_step(problem: Problem, gram: Array, vector: Array, size: int, damping: float) -> Array:
    columns = problem.operators.columns
    total = len(gram) - 1
    dynamic = np.arange(columns, columns + size)
    others = np.r_[0:columns, columns + size:total]
    # Project the linear parameters out of the dynamics columns, then take a damped step.
    cross = gram[np.ix_(others, dynamic)]
    inner = gram[np.ix_(others, others)]
    scale = np.sqrt(np.maximum(np.diag(inner), 1e-300))
    projected = np.linalg.lstsq(inner / scale[:, None] / scale, cross / scale[:, None], rcond=1e-11)[0] / scale[:, None]
    normal = gram[np.ix_(dynamic, dynamic)] - cross.T @ projected
    residual = gram[:, total] - gram[:, :total] @ vector
    gradient = residual[dynamic] - projected.T @ residual[others]
    diagonal = np.maximum(np.diag(normal), 1e-12 * np.max(np.diag(normal)) + 1e-300)
    return np.linalg.solve(normal + damping * np.diag(diagonal), gradient)
