# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Reference simulation FSM: a fast steering mirror of two axes, each tilted by a push-pull pair of stacks (MHL paper §4).

The path of each axis, stepped at 500 kHz or finer:

1. drive: an input delay; the driver's rating clips the voltage.
2. amplifier: a first-order low-pass.
3. hysteresis: two stacks of elastic-slip elements with a saturating curve, one driven by v, one by the bias minus v; their
   difference tilts the mirror. A share of the tilt comes late (relaxation), which widens loops with frequency.
4. mechanics: a notch against the mode and the poles that go with it, then the mode, lightly damped. The paper's driver has the
   notch; its gain at high frequency is (pole / notch frequency)², and a driver that held commands step by step through that
   would turn the hysteresis many times a step, far beyond the rating. Behind the hysteresis the response is the same and what
   drives the stacks stays as smooth as the driver makes it.
5. motion: each axis moves a little with the other.
6. sensor: strain gauge, first-order low-pass, white noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from hyst_plant_sim.physics import exact_discretization
from hyst_plant_sim.physics.elastic_slip import PushPull, Slip
from hyst_plant_sim.physics.mechanics import mechanics, oscillator
from hyst_plant_sim.physics.parameter_checks import check_positive
from hyst_plant_sim.physics.parts import Chain, Clip, Delay, Held, Mixing, Straight, System
from hyst_plant_sim.physics.signal_path import Frame, Part, PlantParameters

PER_AXIS = {"delay": 2, "elastic_slope": 2, "slip_slope": 2, "mode_frequency": 2, "mode_damping": 2}


POSITIVE = (
    "notch_frequency pole_frequency pole_damping amplifier_cutoff elastic_slope slip_range slip_decay "
    "relaxation_time mode_frequency sensor_cutoff"
).split()
"""Parameters that must not be 0."""


@dataclass(frozen=True)
class FsmParameters(PlantParameters):
    """Physical parameters of the FSM; values in config/plants/fsm.yaml."""

    axes: ClassVar[tuple[str, ...]] = ("x", "y")
    unit: ClassVar[str] = "mrad"
    internal_rate: ClassVar[float] = 500e3

    delay: Sequence[float]  # Input delay per axis, s
    # notch_frequency, pole_frequency: Frequencies of the notch against the mode, and of the poles that come with it, Hz
    notch_frequency: float
    # notch_damping, pole_damping: Their damping ratios
    notch_damping: float
    pole_frequency: float
    pole_damping: float
    amplifier_cutoff: float  # First-order cutoff, Hz
    bias: float  # Voltage shared by a pair of stacks, V
    elastic_slope: Sequence[float]  # Slope of a stack right after a reversal per axis, mrad/V
    slip_slope: Sequence[float]  # Slope added once every slip element moves per axis, mrad/V
    slip_elements: int  # Number of elements of a stack
    slip_range: float  # Largest half-width of a slack, V
    slip_decay: float  # Voltage over which the density of the elements falls to 1/e, V
    saturation: float  # Curvature of a stack's stroke, 1/mrad
    relaxation_share: float  # Fraction of the tilt that arrives late
    relaxation_time: float  # Time constant of its arrival, s
    mode_frequency: Sequence[float]  # Frequency of the mode per axis, Hz
    mode_damping: Sequence[float]  # Its damping ratio per axis
    coupling: float  # Fraction of one axis' tilt that the other makes, of opposite signs
    sensor_cutoff: float  # First-order cutoff, Hz
    noise: float  # White noise, mrad rms

    def __post_init__(self) -> None:
        check_positive(self, POSITIVE, PER_AXIS)

    def parts(self, axis: int, frame: Frame, hysteresis: Mapping[str, float], moving: Mapping[str, Any]) -> dict[str, list[Part]]:
        stacks = [
            Slip(
                self.elastic_slope[axis],
                self.slip_slope[axis],
                int(self.slip_elements),
                self.slip_range,
                self.slip_decay,
                self.saturation,
                hysteresis.get("width", 0.0),
            )
            for _ in range(2)
        ]
        rest = 0.5 * stacks[0].settle(self.bias)  # of the second stack at 0 V, halved: the zero of the tilt
        late = Held(
            exact_discretization.slow_share(self.relaxation_share * hysteresis.get("rate", 1.0), self.relaxation_time), frame.step
        )
        delay = Delay(self.delay[axis] + moving.get("delay", 0.0), frame.step)
        mode = mechanics(
            lambda mass_ratio, ratio: oscillator(self.mode_frequency[axis], self.mode_damping[axis], mass_ratio, ratio),
            frame,
            moving,
            delay.rest,
        )
        return {
            "drive": [delay, Clip(*frame.rating)],
            "amplifier": [Held(exact_discretization.lag(2 * np.pi * self.amplifier_cutoff), frame.step)],
            "hysteresis": [Chain(PushPull(stacks[0], stacks[1], self.bias, rest), late)],
            "mechanics": [Chain(Held(self._notch(), frame.step), mode)],
            "sensor": [Straight(exact_discretization.lag(2 * np.pi * self.sensor_cutoff), frame.step)],
        }

    def mixing(self) -> Mixing | None:
        """Coupling of the axes; None without it."""
        return Mixing(np.array([[1.0, self.coupling], [-self.coupling, 1.0]])) if self.coupling else None

    def _notch(self) -> System:
        """(s² + 2 ζn ωn s + ωn²) / (s² + 2 ζp ωp s + ωp²), of unit static gain."""
        zero, pole = 2 * np.pi * self.notch_frequency, 2 * np.pi * self.pole_frequency
        a, b, _, _ = exact_discretization.oscillator(pole, self.pole_damping)
        gain = (pole / zero) ** 2
        # num = gain * den + gain * ((2 ζn ωn - 2 ζp ωp) s + ωn² - ωp²), in states position and velocity / ωp
        slope = gain * 2.0 * (self.notch_damping * zero - self.pole_damping * pole)
        return a, b, np.array([gain * (zero**2 - pole**2) / pole**2, slope / pole]), gain
