# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Monotone curves through (0, 0) for Madelung hysteresis: polynomials and monotone piecewise cubics, in one representation.

A curve is piecewise polynomial: breaks (M + 1,) from exactly 0 to 1 and coefficients (M, degree + 1) in descending powers of the
distance from the piece's left break.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numba import njit

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.chain.bounded_cache import remembered
from hyst_control.chain.c_code.texts import c_texts

C = c_texts(__file__)
EVALUATE, SOLVE = (C[name] for name in ("EVALUATE", "SOLVE"))


@dataclass(frozen=True)
class Curve:
    """A monotone function on [0, 1]; see the module."""

    breaks: Array
    coefficients: Array

    def __call__(self, x: Array) -> Array:
        flat: Array = evaluate_curve_array(np.ascontiguousarray(x, dtype=float).ravel(), self.breaks, self.coefficients)
        return flat.reshape(np.shape(x))


@remembered
def polynomial_curve(coefficients: Array, field: str) -> Curve:
    """Curve p_n x^n + … + p_1 x (MHL paper Eq. 1, 2)."""
    p = np.append(np.asarray(coefficients, dtype=float), 0.0)
    slope = np.polyder(p)
    # A leading coefficient that is next to nothing would put a root near infinity, which the eigenvalue solver refuses.
    slope = np.where(np.abs(slope) > 1e-14 * np.max(np.abs(slope)), slope, 0.0)
    roots = np.roots(slope)
    inside = np.sort(roots[np.abs(roots.imag) < 1e-12].real)
    edges = np.concatenate([[0.0], inside[(inside > 0) & (inside < 1)], [1.0]])
    for left, right in zip(edges[:-1], edges[1:], strict=True):
        if np.polyval(p, right) <= np.polyval(p, left):
            raise InputError(
                f"{field}: the curve falls between {left:.4g} and {right:.4g} of the normalized input: "
                "a branch must rise all the way; correct the coefficients"
            )
    return Curve(np.array([0.0, 1.0]), p.reshape(1, -1))


def knot_curve(knots: Array, values: Array, field: str) -> Curve:
    """Monotone piecewise cubic (Fritsch-Carlson) through values at knots."""
    knots, values = np.asarray(knots, dtype=float), np.asarray(values, dtype=float)
    if len(knots) != len(values) or len(knots) < 2:
        raise InputError(f"{field}: {len(values)} values for {len(knots)} knots: give one value per knot, at least two")
    if knots[0] != 0.0 or knots[-1] != 1.0 or np.any(np.diff(knots) <= 0):
        raise InputError("knots: must increase strictly from 0 to 1")
    if values[0] != 0.0:
        raise InputError(f"{field}: starts at {values[0]:g}, a branch starts at 0")
    if np.any(np.diff(values) <= 0):
        i = int(np.argmax(np.diff(values) <= 0))
        raise InputError(
            f"{field}: the curve falls between {knots[i]:.4g} and {knots[i + 1]:.4g} of the normalized input: "
            "a branch must rise all the way; correct the values"
        )
    from scipy.interpolate import PchipInterpolator  # here, not above: it takes longer to import than all that a node needs

    return Curve(knots, np.ascontiguousarray(PchipInterpolator(knots, values).c.T))


@njit(cache=True, error_model="numpy", inline="always")
def evaluate_curve(x: float, breaks: Array, coefficients: Array) -> Any:
    """Value (a float) of a piecewise polynomial at x; the end pieces continue beyond the ends."""
    degree = coefficients.shape[1]
    if breaks.size == 2:
        value = coefficients[0, 0]
        for i in range(1, degree):
            value = value * x + coefficients[0, i]
        return value
    piece = min(max(int(np.searchsorted(breaks, x, side="right")) - 1, 0), breaks.size - 2)
    d = x - breaks[piece]
    value = coefficients[piece, 0]
    for i in range(1, degree):
        value = value * d + coefficients[piece, i]
    return value


@njit(cache=True, error_model="numpy")
def evaluate_curve_array(x: Annotated[Array, "N"], breaks: Array, coefficients: Array) -> Array:
    """`evaluate_curve` for an array (N,)."""
    output = np.empty_like(x)
    for k in range(x.size):
        output[k] = evaluate_curve(x[k], breaks, coefficients)
    return output


@njit(cache=True, error_model="numpy")
def solve_curve(y: float, breaks: Array, coefficients: Array) -> float:
    """Argument in [0, 1] at which a rising curve reaches y, by bisection safeguarded Newton to the last digits."""
    low, high = 0.0, 1.0
    if y <= evaluate_curve(low, breaks, coefficients):
        return low
    if y >= evaluate_curve(high, breaks, coefficients):
        return high
    x = 0.5
    for _ in range(100):
        piece = 0
        if breaks.size > 2:
            piece = min(max(int(np.searchsorted(breaks, x, side="right")) - 1, 0), breaks.size - 2)
        d = x - breaks[piece]
        value, slope = coefficients[piece, 0], 0.0
        for i in range(1, coefficients.shape[1]):
            slope = slope * d + value
            value = value * d + coefficients[piece, i]
        error = value - y
        if error == 0.0:
            return x
        if error > 0.0:
            high = x
        else:
            low = x
        following = x - error / slope if slope > 0.0 else 0.5 * (low + high)
        if not (low < following < high):
            following = 0.5 * (low + high)
        if abs(following - x) <= 1e-16 + 2e-16 * abs(x):
            return following
        x = following
    return x
