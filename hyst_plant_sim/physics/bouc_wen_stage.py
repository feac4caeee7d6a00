# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A stage whose hysteresis lies inside the feedback of its mechanics, with creep by a power law: for scoring alone.

Oscillator of unit stiffness with a Bouc-Wen force h that the displacement y itself makes, driven by both signs of the voltage u,

    ÿ / ω² + 2 ζ ẏ / ω + y + h = g u,    ḣ = A ẏ - β |ẏ| h - γ ẏ |h|,

integrated by Runge and Kutta's fourth order; behind it lags at times that are spaced evenly on the logarithm, whose shares grow with a
power of the time, and the sensor's white noise. No chain of a hysteresis with linear dynamics before or behind it is this plant.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numba import njit

from hyst_plant_sim.physics.arrays import Array

COMMAND = (-60.0, 60.0)
"""Range of the voltage, V."""
SAMPLE_TIME = 1e-4
FREQUENCY, DAMPING, GAIN = 650.0, 0.08, 0.12
"""Hz; 1; um/V."""
STIFFNESS, BETA, GAMMA = 0.4, 0.35, 0.1
"""A: 1; of the approach to saturation, 1/um."""
CREEP_TIMES = np.geomspace(2e-3, 4.0, 9)
CREEP_SHARE, CREEP_POWER = 0.04, 0.15
"""Share of the stroke that arrives late, and the power of the time with which the lags' shares grow."""
NOISE = 0.0015
"""um rms."""
PIECES = 20
"""Steps of the integration in a sample."""


def respond(command: Annotated[Array, "N 1"], seed: int, noise: float = NOISE) -> Annotated[Array, "N 1"]:
    """Simulate the stage from rest at 0 V."""
    moved = np.empty(len(command))
    _oscillate(np.ascontiguousarray(command[:, 0]), SAMPLE_TIME / PIECES, PIECES, 2.0 * np.pi * FREQUENCY, moved)
    shares = CREEP_TIMES**CREEP_POWER
    shares *= CREEP_SHARE / shares.sum()
    crept = np.empty_like(moved)
    _creep(moved, np.exp(-SAMPLE_TIME / CREEP_TIMES), shares, crept)
    return np.asarray((crept + noise * np.random.default_rng(seed).standard_normal(len(moved)))[:, None], dtype=np.float64)


@njit(cache=True, error_model="numpy")
def _slope(y: float, v: float, h: float, drive: float, w: float) -> tuple[float, float, float]:
    return v, w * w * (drive - y - h) - 2.0 * DAMPING * w * v, STIFFNESS * v - BETA * abs(v) * h - GAMMA * v * abs(h)


@njit(cache=True, error_model="numpy")
def _oscillate(command: Array, step: float, pieces: int, w: float, moved: Array) -> None:
    y = v = h = 0.0
    for k in range(command.size):
        moved[k] = y
        drive = GAIN * command[k]
        for _ in range(pieces):
            y1, v1, h1 = _slope(y, v, h, drive, w)
            y2, v2, h2 = _slope(y + 0.5 * step * y1, v + 0.5 * step * v1, h + 0.5 * step * h1, drive, w)
            y3, v3, h3 = _slope(y + 0.5 * step * y2, v + 0.5 * step * v2, h + 0.5 * step * h2, drive, w)
            y4, v4, h4 = _slope(y + step * y3, v + step * v3, h + step * h3, drive, w)
            y += step * (y1 + 2.0 * y2 + 2.0 * y3 + y4) / 6.0
            v += step * (v1 + 2.0 * v2 + 2.0 * v3 + v4) / 6.0
            h += step * (h1 + 2.0 * h2 + 2.0 * h3 + h4) / 6.0


@njit(cache=True, error_model="numpy")
def _creep(moved: Array, kept: Array, shares: Array, crept: Array) -> None:
    late = np.zeros_like(kept)
    for k in range(moved.size):
        rest = 1.0
        crept[k] = 0.0
        for i in range(kept.size):
            crept[k] += shares[i] * late[i]
            rest -= shares[i]
            late[i] = kept[i] * late[i] + (1.0 - kept[i]) * moved[k]
        crept[k] += rest * moved[k]
