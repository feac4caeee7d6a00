# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Generalized play operators (Al Janaideh, Su & Rakheja, Smart Materials and Structures 17, 2008): play between two curves of the input.

    w = max(γ_a(v) - r, min(γ_d(v) + r, w before)),   y = Σ p_k w_k + constant

The curve γ_a that lifts an operator and the curve γ_d that lowers it may bend and differ: loops that are asymmetric, or that saturate. Used
here to see whether a measured stack asks for them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numba import njit
from scipy.optimize import minimize, nnls

from hyst_control.base.arrays import Array

BUMPS = 2
"""Numbers of a curve: v + c1 v (1 - v) + c2 v (1 - v) (1 - 2 v), for an input v from 0 to 1."""
GRID = np.linspace(0.0, 1.0, 101)


@njit(cache=True, error_model="numpy")
def follow(
    ascending: Annotated[Array, "N"],
    descending: Annotated[Array, "N"],
    thresholds: Annotated[Array, "K"],
    state: Annotated[Array, "K"],
) -> Annotated[Array, "N K"]:
    """Run operators over a record."""
    found = np.empty((len(ascending), len(thresholds)))
    for row in range(len(ascending)):
        for k in range(len(thresholds)):
            low = ascending[row] - thresholds[k]
            high = descending[row] + thresholds[k]
            value = min(high, state[k])
            state[k] = max(low, value)
            found[row, k] = state[k]
    return found


@dataclass(frozen=True)
class GeneralizedPlay:
    """Generalized play operators with their weights."""

    top: float  # Input at which v is 1, V
    thresholds: Annotated[Array, "K"]  # Thresholds (K,)
    curves: Array  # Numbers (2, `BUMPS`) of γ_a and γ_d
    weights: Annotated[Array, "K"]  # Weights (K,), measurement unit
    fitted: float  # Rms error on the record of the fit, measurement unit

    def predict(self, command: Annotated[Array, "N"]) -> Annotated[Array, "N"]:
        """Predict a record up to a constant."""
        predicted: Array = _operators(command / self.top, self.thresholds, self.curves)[0] @ self.weights
        return predicted


def fit_generalized_play(
    command: Annotated[Array, "N"], measurement: Annotated[Array, "N"], thresholds: Annotated[Array, "K"], *, each_way: bool
) -> GeneralizedPlay:
    """Fit weights that are not negative, and the curves, to a closed cycle."""
    top = float(command.max())
    v = command / top

    def curves(numbers: Array) -> Array:
        return numbers.reshape(2, BUMPS) if each_way else np.stack([numbers, numbers])

    def solved(numbers: Array) -> tuple[Array, float]:
        _, memory = _operators(v, thresholds, curves(numbers))  # the cycle before
        columns, _ = _operators(v, thresholds, curves(numbers), memory)
        found, left = nnls(np.column_stack([columns, np.ones(len(v)), -np.ones(len(v))]), measurement)
        return found[: len(thresholds)], float(left) / np.sqrt(len(v))

    def cost(numbers: Array) -> float:
        rising = all(np.all(np.diff(bent(GRID, each)) > 0.0) for each in curves(numbers))
        return solved(numbers)[1] if rising else np.inf

    best = np.zeros(2 * BUMPS if each_way else BUMPS)
    for step in (0.1, 0.03, 0.01):  # each search begins anew at the end of the one before, which may have stalled
        simplex = best + np.vstack([np.zeros(len(best)), step * np.eye(len(best))])
        options = {"xatol": 1e-4, "fatol": 1e-6, "maxfev": 100 * len(best), "initial_simplex": simplex}
        best = minimize(cost, best, method="Nelder-Mead", options=options).x
    weights, fitted = solved(best)
    return GeneralizedPlay(top, thresholds, curves(best), weights, fitted)


def bent(v: Annotated[Array, "N"], numbers: Array) -> Annotated[Array, "N"]:
    """Curve of an input from 0 to 1 that is 0 at 0 and 1 at 1."""
    found: Array = v + v * (1.0 - v) * (numbers[0] + numbers[1] * (1.0 - 2.0 * v))
    return found


def _operators(v: Array, thresholds: Array, curves: Array, memory: Array | None = None) -> tuple[Array, Array]:
    """Outputs (N, K) to an input that is held until the next sample, and the state (K,) after it."""
    held = np.concatenate([v[:1], v[:-1]])
    ascending, descending = bent(held, curves[0]), bent(held, curves[1])
    state = np.full(len(thresholds), ascending[0]) if memory is None else memory.copy()
    return follow(ascending, descending, thresholds, state), state
