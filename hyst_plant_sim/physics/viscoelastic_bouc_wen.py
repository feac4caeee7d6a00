# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A third physics that no simulator of this project matches: Bouc-Wen hysteresis and a viscoelastic ladder.

The path of a command, stepped at 200 kHz or finer: amplifier (second order); free stroke Y = d u - z with
dz/du = α - (β sgn(u̇ z) + γ) |z|^n, α growing with the voltage from one end of the rating to the other: the memory z holds the
stroke back, on the way up as on the way down; a Zener ladder, each of whose branches delays a part of the stroke; one
mode; sensor (first-order low-pass, white noise).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numba import njit

from hyst_plant_sim.physics import exact_discretization
from hyst_plant_sim.physics.arrays import Array
from hyst_plant_sim.physics.mechanics import mechanics, oscillator
from hyst_plant_sim.physics.parameter_checks import check_positive
from hyst_plant_sim.physics.parts import Chain, Delay, Held, Straight, System
from hyst_plant_sim.physics.signal_path import Frame, Part, PlantError, PlantParameters

PIECE = 0.5
"""Most volts in one step of the hysteresis' own equation."""

SHORT = 0.2
"""Volts below which a rule of second order does for such a step: z bends over some 30 V, which leaves about 1e-6 of the stroke."""


@dataclass(frozen=True)
class ViscoelasticBoucWenParameters(PlantParameters):
    """Physical parameters of the third plant; values in config/plants/third.yaml."""

    axes: ClassVar[tuple[str, ...]] = ("x",)
    unit: ClassVar[str] = "um"
    internal_rate: ClassVar[float] = 200e3

    amplifier_frequency: float  # Second-order cutoff, Hz
    amplifier_damping: float  # Its damping ratio
    slope: float  # Slope without memory, um/V
    alpha: float  # Growth of the memory from rest, um/V
    alpha_growth: float  # Relative growth of alpha from one end of the rating to the other
    beta: float  # Approach to saturation, 1/V um^(1 - exponent)
    gamma: float  # The same, for either direction of the drive
    exponent: float  # Exponent n of |z|
    ladder_shares: Sequence[float]  # Fractions of the stroke that arrive late
    ladder_times: Sequence[float]  # Time constants of their arrival, s
    mode_frequency: float  # Frequency of the mode, Hz
    mode_damping: float  # Its damping ratio
    sensor_cutoff: float  # First-order cutoff, Hz
    noise: float  # White noise, um rms

    def __post_init__(self) -> None:
        check_positive(
            self,
            ("amplifier_frequency", "slope", "exponent", "ladder_times", "mode_frequency", "sensor_cutoff"),
            {"ladder_shares": None, "ladder_times": None},
        )
        if len(self.ladder_shares) != len(self.ladder_times):
            raise PlantError(
                f"ladder_times: {len(self.ladder_times)} for {len(self.ladder_shares)} of ladder_shares: give one each"
            )

    def parts(self, axis: int, frame: Frame, hysteresis: Mapping[str, float], moving: Mapping[str, Any]) -> dict[str, list[Part]]:
        rate = hysteresis.get("rate", 1.0)
        delay = Delay(moving.get("delay", 0.0), frame.step)
        return {
            "drive": [delay],
            "amplifier": [Held(oscillator(self.amplifier_frequency, self.amplifier_damping), frame.step)],
            "hysteresis": [
                Chain(BoucWen(self, frame.rating, 1.0 + hysteresis.get("width", 0.0)), Held(self._ladder(rate), frame.step))
            ],
            "mechanics": [
                mechanics(
                    lambda mass_ratio, ratio: oscillator(self.mode_frequency, self.mode_damping, mass_ratio, ratio),
                    frame,
                    moving,
                    delay.rest,
                )
            ],
            "sensor": [Straight(exact_discretization.lag(2 * np.pi * self.sensor_cutoff), frame.step)],
        }

    def _ladder(self, rate: float) -> System:
        rates, shares = 1.0 / np.array(self.ladder_times, dtype=float), rate * np.array(self.ladder_shares, dtype=float)
        return np.diag(-rates), rates, shares, float(1.0 - shares.sum())


class BoucWen(Part):
    """Bouc-Wen hysteresis: free stroke Y (um) for a voltage."""

    def __init__(self, p: ViscoelasticBoucWenParameters, rating: tuple[float, float], memory: float) -> None:
        self._law = np.array(
            [p.slope, p.alpha, p.alpha_growth / (rating[1] - rating[0]), p.beta, p.gamma, p.exponent, memory, rating[0]]
        )
        self._state = np.zeros(2)

    def settle(self, value: float) -> float:
        """Start with empty memory and move to a constant voltage."""
        self._state[:] = 0.0
        return float(self.process(np.array([value]))[0])

    def process(self, block: Array) -> Array:
        """Integrate the hysteresis along a block."""
        output = np.empty(block.size)
        _bouc_wen(block, self._law, self._state, output)
        return output


@njit(cache=True, error_model="numpy")
def _slope(u: float, z: float, sign: float, law: Array) -> float:
    size = abs(z) ** law[5]
    slope: float = law[1] * (1.0 + law[2] * (u - law[7])) - (law[3] * (1.0 if z * sign > 0 else -1.0) + law[4]) * size
    return slope


@njit(cache=True, error_model="numpy")
def _bouc_wen(block: Array, law: Array, state: Array, output: Array) -> None:
    u, z = state
    for k in range(block.size):
        way = block[k] - u
        if way != 0.0:
            pieces = int(np.ceil(abs(way) / PIECE))
            part, sign = way / pieces, np.sign(way)
            for _ in range(pieces):
                first = _slope(u, z, sign, law)
                second = _slope(u + 0.5 * part, z + 0.5 * part * first, sign, law)
                if abs(part) < SHORT:  # the midpoint rule
                    z += part * second
                    u += part
                    continue
                # Runge and Kutta's fourth order
                third = _slope(u + 0.5 * part, z + 0.5 * part * second, sign, law)
                fourth = _slope(u + part, z + part * third, sign, law)
                z += part * (first + 2.0 * second + 2.0 * third + fourth) / 6.0
                u += part
            u = block[k]
        output[k] = law[0] * u - law[6] * z
    state[0], state[1] = u, z
