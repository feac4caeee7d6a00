# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Outlying units: those whose quantities, taken together, do not fit to the fleet's scatter."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.stats import chi2, false_discovery_control

from hyst_control.base.arrays import Array

STARTS = 50
STEPS = 20
SHARE = 0.75  # Share of the units that the scatter is estimated from, at first
FALSE_SHARE = 0.05  # False discovery rate
WELL_WITHIN = 0.975  # Quantile of the distances within which a unit counts for the final scatter


@dataclass(frozen=True)
class Outlier:
    """A unit apart from the fleet."""

    unit: str  # The unit
    distance: float  # Mahalanobis distance from the fleet's center
    probability: float  # Adjusted p-value: the false discovery rate at which it would just be named
    farthest: str  # Quantity that lies farthest from the center, in its own standard deviations
    deviation: float  # That many


def find_outliers(units: Sequence[str], quantities: Sequence[str], values: Annotated[Array, "U P"]) -> list[Outlier]:
    """Find units apart from the fleet, with the false discovery rate controlled (Benjamini and Hochberg 1995)."""
    # Center and covariance are those of the units that lie closest together (minimum covariance determinant, Rousseeuw and Van Driessen
    # 1999), so that the units looked for do not hide themselves.
    if not values.size:
        return []
    spread = values.std(axis=0)
    used = np.flatnonzero(spread > 1e-12 * np.maximum(np.abs(values).max(axis=0), 1e-300))
    count, width = len(values), len(used)
    if width == 0 or count < 2 * width + 2:
        return []
    scaled = values[:, used] / spread[used]
    center, covariance = _closest_together(scaled, np.random.default_rng(0))
    squared = _distances(scaled, center, covariance)
    adjusted = false_discovery_control(chi2.sf(squared, width))
    deviations = (scaled - center) / np.sqrt(np.diag(covariance))
    found = []
    for index in np.argsort(-squared):
        if adjusted[index] <= FALSE_SHARE:
            worst = int(np.abs(deviations[index]).argmax())
            name = quantities[int(used[worst])]
            found.append(
                Outlier(units[index], float(np.sqrt(squared[index])), float(adjusted[index]), name, float(deviations[index, worst]))
            )
    return found


def _closest_together(values: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Center and covariance of the bulk, from the subset with the smallest determinant, then from all that lie well within."""
    count, width = values.shape
    kept = max(int(SHARE * count), width + 2)
    best: tuple[float, Array, Array] | None = None
    for start in range(STARTS):
        if start == 0:  # the units closest to the median, by their own scales
            rows = np.argsort(np.abs(values - np.median(values, axis=0)).sum(axis=1))[:kept]
        else:
            rows = rng.choice(count, width + 1, replace=False)
        for _ in range(STEPS):
            center, covariance = values[rows].mean(axis=0), _covariance(values[rows])
            following = np.argsort(_distances(values, center, covariance))[:kept]
            if set(following) == set(rows):
                break
            rows = following
        determinant = float(np.linalg.slogdet(covariance)[1])
        if best is None or determinant < best[0]:
            best = determinant, center, covariance
    assert best is not None
    _, center, covariance = best
    covariance = _to_scale(covariance, _distances(values, center, covariance), width)
    within = _distances(values, center, covariance) <= chi2.ppf(WELL_WITHIN, width)
    center, covariance = values[within].mean(axis=0), _covariance(values[within])
    return center, _to_scale(covariance, _distances(values, center, covariance), width)


def _covariance(rows: Array) -> Array:
    found = np.atleast_2d(np.cov(rows, rowvar=False))
    return np.asarray(found + 1e-9 * np.trace(found) / len(found) * np.eye(len(found)))


def _to_scale(covariance: Array, squared: Array, width: int) -> Array:
    """Covariance made larger until the median distance is that of a normal fleet."""
    return np.asarray(covariance * (np.median(squared) / chi2.median(width)))


def _distances(values: Array, center: Array, covariance: Array) -> Array:
    """Squared Mahalanobis distances (U,)."""
    off = values - center
    return np.asarray(np.sum(off * np.linalg.solve(covariance, off.T).T, axis=1))
