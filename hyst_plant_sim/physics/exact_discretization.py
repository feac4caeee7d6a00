# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Exact steps of linear parts whose input is held, or runs straight from one value to another."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

from hyst_plant_sim.physics.arrays import Array


def held_step(a: Array, b: Array, step: float) -> tuple[Array, Array]:
    """Discretize x' = a x + b u with u held over a step: x ← Φ x + Γ u."""
    n = len(a)
    block = np.zeros((n + 1, n + 1))
    block[:n, :n], block[:n, n] = a, b
    result = expm(block * step)
    return result[:n, :n], result[:n, n]


def ramp_step(a: Array, b: Array, step: float) -> tuple[Array, Array, Array]:
    """Discretize x' = a x + b u with u straight from u0 to u1 over a step: x ← Φ x + Γ0 u0 + Γ1 u1."""
    phi, gamma = held_step(a, b, step)
    n = len(a)
    # The response to a ramp of slope 1 / step is the integral of the response to a step: one more integrator in front.
    block = np.zeros((n + 2, n + 2))
    block[:n, :n], block[:n, n], block[n, n + 1] = a, b, 1.0 / step
    ramp = expm(block * step)[:n, n + 1]
    return phi, gamma - ramp, ramp


def mean_of_step(a: Array, b: Array, step: float) -> tuple[Array, Array]:
    """Mean M x + m u of the state over a step whose input u is held, x being the state at its beginning."""
    n = len(a)
    block = np.zeros((2 * n + 1, 2 * n + 1))
    block[:n, :n], block[:n, n], block[n + 1 :, :n] = a, b, np.eye(n) / step  # the last rows integrate
    result = expm(block * step)[n + 1 :]
    return result[:, :n], result[:, n]


def rest(a: Array, b: Array, value: float) -> Array:
    """State at rest for a constant input."""
    return np.asarray(-np.linalg.solve(a, b) * value, dtype=np.float64)


def series(
    first: tuple[Array, Array, Array, float], second: tuple[Array, Array, Array, float]
) -> tuple[Array, Array, Array, float]:
    """Connect two single-input systems, the first feeding the second."""
    a1, b1, c1, d1 = first
    a2, b2, c2, d2 = second
    n1, n2 = len(a1), len(a2)
    a = np.zeros((n1 + n2, n1 + n2))
    a[:n1, :n1], a[n1:, n1:], a[n1:, :n1] = a1, a2, np.outer(b2, c1)
    return a, np.concatenate([b1, b2 * d1]), np.concatenate([d2 * c1, c2]), d1 * d2


def lag(rate: float) -> tuple[Array, Array, Array, float]:
    """First-order low-pass of unit gain."""
    return np.array([[-rate]]), np.array([rate]), np.array([1.0]), 0.0


def oscillator(frequency: float, damping: float) -> tuple[Array, Array, Array, float]:
    """Mass, spring and damper of unit static gain; the states are position and velocity / ω."""
    w = frequency
    return np.array([[0.0, w], [-w, -2.0 * damping * w]]), np.array([0.0, w]), np.array([1.0, 0.0]), 0.0


def slow_share(share: float, time_constant: float) -> tuple[Array, Array, Array, float]:
    """Viscoelastic element: a fraction of the final value arrives late, the rest at once."""
    rate = 1.0 / time_constant
    return np.array([[-rate]]), np.array([rate]), np.array([share]), 1.0 - share
