# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The published HAMPI model as a plant, independent of the simulator's code, with which the simulator's chain is compared.

Play operators in the form of HAMPI paper Eq. 3, dynamic weights of Eq. 4-6, the dynamics G(s) of Eq. 7 with the slow
pole-zero pair, stepped exactly. The rate is the difference over one sample time of the voltage, as a held command has it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np
from numba import njit

from hyst_plant_sim.physics.arrays import Array
from hyst_plant_sim.physics.mechanics import mechanics
from hyst_plant_sim.physics.parts import Delay
from hyst_plant_sim.physics.rational_mechanics import rational
from hyst_plant_sim.physics.signal_path import Frame, Part, PlantError, PlantParameters


@dataclass(frozen=True)
class PublishedPeaParameters(PlantParameters):
    """Figures of the published HAMPI model."""

    axes: ClassVar[tuple[str, ...]] = ("x",)
    unit: ClassVar[str] = "um"
    internal_rate: ClassVar[float] = 200e3

    thresholds: Sequence[float]  # Thresholds of the play operators, V
    weights: Sequence[float]  # Weights, um/V per unit of G's static gain
    # m1, m2: Rate gains of the weights, s/V
    m1: float
    m2: float
    k: float  # Level gain of the weights, 1/V
    b: float  # Constant of the weights
    # num, den: Polynomials of G(s)
    num: Sequence[float]
    den: Sequence[float]
    noise: float = 0.0  # White noise, um rms

    def __post_init__(self) -> None:
        if len(self.thresholds) != len(self.weights):
            raise PlantError(f"weights: {len(self.weights)} for {len(self.thresholds)} thresholds: give one each")

    def parts(self, axis: int, frame: Frame, hysteresis: Mapping[str, float], moving: Mapping[str, Any]) -> dict[str, list[Part]]:
        delay = Delay(moving.get("delay", 0.0), frame.step)
        return {
            "drive": [delay],
            "hysteresis": [DynamicWeights(self, frame, hysteresis.get("width", 0.0), hysteresis.get("rate", 1.0))],
            "mechanics": [mechanics(partial(rational, self.num, self.den), frame, moving, delay.rest)],
        }


class DynamicWeights(Part):
    """Play operators with dynamic weights: Σ (w_i + k u + b - m1 u̇ or + m2 u̇) H_i."""

    def __init__(self, parameters: PublishedPeaParameters, frame: Frame, width: float, rate: float) -> None:
        p = parameters
        self._r, self._w = np.array(p.thresholds, dtype=float), np.array(p.weights, dtype=float)
        self._law = np.array([p.m1 * rate, p.m2 * rate, p.k, p.b, width, frame.sample_time])
        self._past = np.zeros(frame.substeps)

    def settle(self, value: float) -> float:
        """Start from the virgin state at a constant drive with no rate."""
        self._past[:] = value
        self._h = np.clip(0.0, value - self._r, value + self._r)
        return float(self.process(np.array([value]))[0])

    def process(self, block: Array) -> Array:
        """Compute the output of a block with rate-dependent weights."""
        known = np.concatenate([self._past, block])
        self._past = known[len(block) :].copy()
        output = np.empty(block.size)
        _dynamic_weights(block, known[: len(block)], self._r, self._w, self._law, self._h, output)
        return output


@njit(cache=True, error_model="numpy")
def _dynamic_weights(block: Array, earlier: Array, r: Array, w: Array, law: Array, h: Array, output: Array) -> None:
    for k in range(block.size):
        u = block[k]
        rate = (u - earlier[k]) / law[5]
        extra = law[2] * u + law[3] + (-law[0] if rate >= 0.0 else law[1]) * rate
        total = 0.0
        for i in range(r.size):
            h[i] = max(u - r[i], min(u + r[i], h[i]))
            total += (w[i] + extra) * (h[i] + law[4] * (h[i] - u))
        output[k] = total
