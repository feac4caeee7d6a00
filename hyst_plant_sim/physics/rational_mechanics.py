# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A published transfer function as mechanics: its only pair of complex poles is the main mode, which may be altered."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hyst_plant_sim.physics.arrays import Array
from hyst_plant_sim.physics.parts import System
from hyst_plant_sim.physics.signal_path import PlantError


def rational(num: Sequence[float], den: Sequence[float], mass_ratio: float = 0.0, frequency_ratio: float = 1.0) -> System:
    """Convert num(s) / den(s) to a system, with the main mode's mass and frequency changed; the static gain stays."""
    top, bottom = np.array(num, dtype=float), np.array(den, dtype=float)
    if mass_ratio or frequency_ratio != 1.0:
        bottom, gain = _altered(bottom, mass_ratio, frequency_ratio)
        top = top * gain
    return observer_form(top, bottom)


def observer_form(num: Array, den: Array) -> System:
    """Convert a strictly proper num(s) / den(s) to observer form; the states are scaled to about the size of the output."""
    num, den = num / den[0], den / den[0]
    n = len(den) - 1
    num = np.concatenate([np.zeros(n - len(num)), num])
    size = abs(den[-1]) ** (1.0 / n)
    a, b = np.zeros((n, n)), np.zeros(n)
    for i in range(n):
        a[i, 0] = -den[i + 1] / size**i
        b[i] = num[i] / size**i
        if i + 1 < n:
            a[i, i + 1] = size
    return a, b, np.eye(n)[0], 0.0


def _altered(den: Array, mass_ratio: float, frequency_ratio: float) -> tuple[Array, float]:
    poles = np.roots(den)
    pair = poles[np.abs(poles.imag) > 1e-9 * np.abs(poles)]
    if len(pair) != 2:
        raise PlantError(f"den: must have one pair of complex poles, the main mode, got {len(pair)} complex poles")
    damping, stiffness = -2.0 * pair[0].real, abs(pair[0]) ** 2  # of a unit mass
    mass = 1.0 + mass_ratio
    mode = np.array([1.0, damping * frequency_ratio / mass, stiffness * frequency_ratio**2 / mass])
    rest = np.polydiv(den, np.array([1.0, damping, stiffness]))[0]
    altered = np.polymul(rest, mode)
    return altered, altered[-1] / den[-1]
