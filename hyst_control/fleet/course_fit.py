# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A quantity of one unit over runs, and what a shape added to it explains: generalized least squares under noise and a random walk.

    x = mu + walk + noise + delta c(t),   cov(walk + noise) = sigma^2 I + q^2 min(s, t)

With a flat prior of mu and delta ~ N(0, tau^2), the evidence for each shape c has a closed form.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from hyst_control.base.arrays import Array

MAD = 1.4826  # Standard deviation of a normal variable over its median absolute deviation


class CourseFit:
    """Generalized least squares of a unit's runs with each of several shapes in turn."""

    def __init__(self, values: Annotated[Array, "T"], shapes: Annotated[Array, "T S"], white: float, walk: float) -> None:
        place = np.arange(len(values), dtype=float)
        factor = cho_factor(white * np.eye(len(values)) + walk * np.minimum.outer(place + 1.0, place + 1.0))
        mean = float(values.mean())
        values = values - mean  # a level far above the scatter would cost digits below
        solved = cho_solve(factor, np.column_stack([np.ones(len(values)), values, shapes]))
        weight = solved[:, 0]
        level = float(weight @ values / weight.sum())
        rest = solved[:, 1] - level * weight
        information = np.einsum("ij,ij->j", shapes, solved[:, 2:]) - (weight @ shapes) ** 2 / weight.sum()
        self._variance = 1.0 / information
        self._size = (rest @ shapes) / information
        self._level = mean + level
        self._means = (weight @ shapes) / weight.sum()
        self.likelihood = -float(np.log(np.diag(factor[0])).sum() + 0.5 * np.log(weight.sum()) + 0.5 * (values - level) @ rest)

    def evidence(self, tau: float) -> tuple[float, Array]:
        """Logarithm of the odds of a shape of size tau, and the probability of each shape, given that there is one."""
        total = self._variance + tau**2
        each = 0.5 * (np.log(self._variance / total) + self._size**2 * (1.0 / self._variance - 1.0 / total))
        highest = float(each.max())
        relative = np.exp(each - highest)
        return highest + float(np.log(relative.mean())), relative / relative.sum()

    def size(self, index: int, tau: float) -> tuple[float, float]:
        """Size of a shape and its standard error."""
        shrunk = tau**2 / (tau**2 + self._variance[index])
        return float(shrunk * self._size[index]), float(np.sqrt(shrunk * self._variance[index]))

    def level(self, index: int, size: float) -> float:
        """Level of the record under a shape of a given size."""
        return float(self._level - size * self._means[index])


def successive_differences(*quantities: Annotated[Array, "U T"]) -> tuple[Annotated[Array, "Q D"], NDArray[np.intp]]:
    """Differences of Q quantities between successive runs of a unit in which all are known, and the columns (D,) of the earlier runs."""
    # Columns are the times of all units: where units have times of their own, a unit's next run is not in the next column.
    unit, run = np.nonzero(np.all(np.isfinite(quantities), axis=0))
    same = unit[1:] == unit[:-1]
    return np.diff([values[unit, run] for values in quantities])[:, same], run[:-1][same]


def run_variance(values: Annotated[Array, "U T"]) -> float:
    """Variance of the differences of successive runs over a fleet; robust to a few units that change."""
    (known,), _ = successive_differences(values)
    if not len(known):
        return 0.0
    spread = MAD * np.median(np.abs(known - np.median(known)))
    return float(spread**2) if spread > 0.0 else float(np.var(known))


def named_within(probabilities: Array, false_share: float) -> int:
    """Number of claims, most probable first, whose expected share of errors stays within a bound (Müller, Parmigiani and Rice 2006)."""
    # Where many are sure the bound leaves room for a few that are probably wrong: each must be more probable than not as well.
    errors = np.cumsum(1.0 - probabilities) / np.arange(1, len(probabilities) + 1)
    return min(int(np.searchsorted(errors, false_share, side="right")), int(np.sum(probabilities > 0.5)))
