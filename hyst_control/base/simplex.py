# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Minimum of a function of few parameters without derivatives, by the simplex of Nelder and Mead (1965)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array


def lowest(
    function: Callable[[Array], float], simplex: Annotated[Array, "P+1 P"], apart: float, differ: float, steps: int = 400
) -> tuple[Annotated[Array, "P"], float]:
    """Lowest point that a simplex comes to and the value there; it ends with corners so little apart, whose values differ so little."""
    # The same steps as scipy.optimize.minimize, whose import alone would take longer than all of them
    points, values = np.array(simplex, dtype=float), np.array([function(point) for point in simplex])
    for _ in range(steps - 1):
        order = np.argsort(values)
        points, values = points[order], values[order]
        if np.abs(points[1:] - points[0]).max() <= apart and np.abs(values[1:] - values[0]).max() <= differ:
            break
        middle, worst = points[:-1].sum(axis=0) / (len(points) - 1), points[-1]
        point = 2.0 * middle - worst
        value = function(point)
        if value < values[0]:
            farther = 3.0 * middle - 2.0 * worst
            if (beyond := function(farther)) < value:
                point, value = farther, beyond
        elif value >= values[-2]:
            outside = value < values[-1]
            nearer = 1.5 * middle - 0.5 * worst if outside else 0.5 * middle + 0.5 * worst
            within = function(nearer)
            if not (within <= value if outside else within < values[-1]):
                points[1:] = points[0] + 0.5 * (points[1:] - points[0])
                values[1:] = [function(point) for point in points[1:]]
                continue
            point, value = nearer, within
        points[-1], values[-1] = point, value
    best = int(np.argmin(values))
    return points[best], float(values[best])
