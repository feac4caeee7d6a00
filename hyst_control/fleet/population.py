# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Usual coefficients of a fleet: their center and scatter over its units, and those of one unit as far as all of them tell.

The coefficients of a unit, identified in several runs, are taken for its level, which differs between units and walks between
runs, and an error of the run:

    x(u, t) = level(u, t) + e(u, t),   level(u, .) - mu ~ N(0, B) at first, its steps ~ N(0, rho C), e ~ N(0, (1 - rho) / 2 C)

C is the covariance of the differences of successive runs, rho the share of it that grows with the distance of the runs. Both are the
fleet's. mu and B follow by the expectation-maximization of a normal population (empirical Bayes), in which units far out count less, so
that a faulty one does not make faults usual. A unit's own level is then drawn toward the fleet's (partial pooling).
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.stats import chi2

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.fleet.course_fit import MAD

FARTHEST_RUNS = 5  # Runs between two records up to which the growth of their difference is looked at
WITHIN = 0.975  # Quantile of the distances beyond which a unit counts less
PASSES = 200
TOLERANCE = 1e-8  # Relative change of the scatter at which the passes end
MIN_UNITS = 3


@dataclass(frozen=True)
class Population:
    """Center and scatter of a fleet's coefficients, and the units' own levels."""

    center: Annotated[Array, "K"]  # Means over the units (K,)
    between: Annotated[Array, "K K"]  # Covariance of the units' levels (K, K)
    # Covariance C of the differences of successive runs (K, K); of the identifications' errors alone where no unit has two runs
    between_runs: Annotated[Array, "K K"]
    walk: float  # Share rho of it that is a walk, 1
    # Mean covariance of the identifications' own errors (K, K), which is a part of a run's error but none of the unit's
    error: Annotated[Array, "K K"]
    units: tuple[str, ...]  # Names of the units (U,)
    levels: Annotated[Array, "U K"]  # Their newest levels by their own runs alone (U, K)
    spreads: Annotated[Array, "U"]  # Variances of these, in multiples of `between_runs` (U,)
    repeated: bool  # Whether units have several runs, from which alone their scatter between runs is known

    def usual(self) -> tuple[Array, Array]:
        """Mean (K,) and covariance (K, K) of the coefficients of any unit in any run."""
        return self.center, self.between + self._single_run()

    def of_unit(self, unit: str) -> tuple[Array, Array]:
        """Mean and covariance of a unit's coefficients in its coming run, by its own runs and the fleet."""
        if unit not in self.units:
            raise InputError(f"{unit}: no such unit in this study, there are {', '.join(self.units[:5])}, …")
        if not self.repeated:
            raise InputError(f"{unit}: has one run, as all units: identify several runs of units, or take the fleet's coefficients")
        index = self.units.index(unit)
        share = np.linalg.solve(self.between + self.spreads[index] * self.between_runs, self.between).T
        mean = self.center + share @ (self.levels[index] - self.center)
        left = self.between - share @ self.between
        return mean, 0.5 * (left + left.T) + self.walk * self.between_runs + self._single_run()

    def _single_run(self) -> Array:
        """Covariance of what one run does to a unit, without the errors of its identification."""
        return _positive(0.5 * (1.0 - self.walk) * self.between_runs - self.error)


def find_population(
    units: Sequence[str], moments: Annotated[Array, "N"], values: Annotated[Array, "N K"], errors: Annotated[Array, "N K K"]
) -> Population:
    """Center and scatter of the coefficients of a fleet."""
    rows = defaultdict(list)
    for row, unit in enumerate(units):
        rows[unit].append(row)
    names = tuple(sorted(rows))
    if len(names) < MIN_UNITS:
        raise InputError(f"{len(names)} units with a model of one structure: a population needs {MIN_UNITS} at least")
    ordered = [np.array(sorted(rows[name], key=lambda row: moments[row])) for name in names]
    scale = _scale(values)
    scaled, error = values / scale, errors.mean(axis=0) / np.outer(scale, scale)
    repeated = sum(len(each) - 1 for each in ordered) > 1
    if repeated:
        between_runs, walk = _between_runs([scaled[each] for each in ordered])
    else:
        # Stated errors above the scatter of all models together are too large: taken off, they would leave units without any.
        error = error if np.all(np.diag(error) < 1.0) else np.zeros_like(error)
        between_runs, walk = 2.0 * error, 0.0
    found = [_level(scaled[each], walk) for each in ordered]
    levels, spreads = np.array([level for level, _ in found]), np.array([spread for _, spread in found])
    center, between = _between(levels, spreads, between_runs)
    square = np.outer(scale, scale)
    covariances = between * square, between_runs * square, walk, error * square
    return Population(center * scale, *covariances, names, levels * scale, spreads, repeated)


def _scale(values: Array) -> Array:
    """Size of the scatter of every coefficient (K,), to count all of them alike."""
    spread = MAD * np.median(np.abs(values - np.median(values, axis=0)), axis=0)
    spread = np.where(spread > 0.0, spread, values.std(axis=0))
    return np.asarray(np.where(spread > 0.0, spread, 1.0))


def _between_runs(series: Sequence[Array]) -> tuple[Array, float]:
    """Covariance of the differences of successive runs, and the share of it that is a walk."""
    differences = {
        lag: np.concatenate([each[lag:] - each[:-lag] for each in series if len(each) > lag] or [np.zeros((0, series[0].shape[1]))])
        for lag in range(1, FARTHEST_RUNS + 1)
    }
    covariance = _covariance(differences[1])
    lags = [lag for lag in differences if len(differences[lag]) > 1]
    sizes = np.array([np.mean([_variance(column) for column in differences[lag].T]) for lag in lags])
    if len(lags) < 2:
        return covariance, 0.0
    growth = np.polyfit(lags, sizes / sizes[0], 1)[0]
    return covariance, float(np.clip(growth, 0.0, 1.0))


def _variance(column: Array) -> float:
    return float((MAD * np.median(np.abs(column))) ** 2)


def _covariance(differences: Array) -> Array:
    """Covariance about 0 in which rows far out count less, drawn toward its diagonal where there are few rows."""
    count = len(differences)
    found = np.diag([max(_variance(column), 1e-12) for column in differences.T])
    for _ in range(PASSES):
        weights = _weights(differences, found)
        new = _shrunk((weights[:, None] * differences).T @ differences / count, count)
        if np.max(np.abs(new - found)) < TOLERANCE * np.max(np.abs(found)):
            return new
        found = new
    return found


def _weights(off: Array, covariance: Array) -> Array:
    """Huber's weights of rows by their squared Mahalanobis distances from 0: 1 for what a normal population has."""
    squared = np.sum(off * np.linalg.solve(covariance, off.T).T, axis=1)
    return np.asarray(np.minimum(1.0, chi2.ppf(WITHIN, len(covariance)) / np.maximum(squared, 1e-300)))


def _shrunk(covariance: Array, count: int) -> Array:
    """Covariance with its correlations as far as so many rows can tell them; a floor keeps it invertible."""
    width = len(covariance)
    share = width / (width + count)
    diagonal = np.diag(np.diag(covariance))
    return (1.0 - share) * covariance + share * diagonal + 1e-9 * max(float(np.trace(covariance)), 1e-12) / width * np.eye(width)


def _level(series: Array, walk: float) -> tuple[Array, float]:
    """Newest level of one unit by its own runs (K,), and its variance in multiples of C: a local level filter, diffuse at first."""
    error = 0.5 * (1.0 - walk)
    level, spread = series[0].copy(), error
    for run in series[1:]:
        spread += walk
        gain = spread / (spread + error) if spread + error > 0.0 else 0.0
        level = level + gain * (run - level)
        spread *= 1.0 - gain
    return level, spread


def _between(levels: Array, spreads: Array, between_runs: Array) -> tuple[Array, Array]:
    """Mean and covariance of the units' levels, whose errors are known, by expectation-maximization."""
    count, width = levels.shape
    center = np.median(levels, axis=0)
    between = np.diag(np.maximum(np.array([_variance(column) for column in (levels - center).T]), 1e-12))
    alike = [np.flatnonzero(spreads == spread) for spread in np.unique(spreads)]  # of as many runs
    for _ in range(PASSES):
        weights, expected, second = np.zeros(count), np.zeros((count, width)), np.zeros((width, width))
        for rows in alike:
            whole = between + spreads[rows[0]] * between_runs
            off = levels[rows] - center
            weights[rows] = _weights(off, whole)
            share = np.linalg.solve(whole, between).T
            expected[rows] = off @ share.T
            second += (weights[rows, None] * expected[rows]).T @ expected[rows] + len(rows) * (between - share @ between)
        center = center + np.average(expected, axis=0, weights=weights)
        new = _shrunk(0.5 * (second + second.T) / count, count)
        if np.max(np.abs(new - between)) < TOLERANCE * np.max(np.abs(between)):
            return center, new
        between = new
    return center, between


def _positive(covariance: Array) -> Array:
    """The nearest covariance without negative variances."""
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)
