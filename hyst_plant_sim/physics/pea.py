# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Reference simulation PEA: amplifier, polarization with hysteresis and drag, flexure mechanics, capacitive sensor.

The path of a command, each part in continuous time, stepped at 400 kHz or finer:

1. drive: a transport delay (converter, isolation), then the amplifier, a first-order low-pass; its output is the voltage v.
2. hysteresis: an elastic slope and an ensemble of elastic-slip elements (see `elastic_slip`), whose sum Y0 is bent by a single-valued
   saturation Y = Y0 - β Y0² / stroke.
3. drag: domain walls move against viscous drag that grows with the polarization P already reached, more while it rises than
   while it falls: P' = (Y - P) / T(Y), T = T_rise or T_fall times Y / (Y + drag_level). Slow loops do not show it; fast ones
   turn and widen, the more the higher the drive.
4. mechanics: one flexure mode, and a viscoelastic part that arrives late (the slow pole-zero pair of HAMPI paper Eq. 7).
5. sensor: first-order low-pass, white noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numba import njit

from hyst_plant_sim.physics import exact_discretization
from hyst_plant_sim.physics.arrays import Array
from hyst_plant_sim.physics.elastic_slip import Slip
from hyst_plant_sim.physics.mechanics import mechanics, oscillator
from hyst_plant_sim.physics.parameter_checks import check_positive
from hyst_plant_sim.physics.parts import Chain, Delay, Held, Straight, System
from hyst_plant_sim.physics.signal_path import Frame, Part, PlantParameters

POSITIVE = ("amplifier_cutoff elastic_slope slip_range slip_decay stroke mode_frequency slow_time sensor_cutoff drag_level").split()
"""Parameters that must not be 0."""


@dataclass(frozen=True)
class PeaParameters(PlantParameters):
    """Physical parameters of the PEA; values in config/plants/pea.yaml."""

    axes: ClassVar[tuple[str, ...]] = ("x",)
    unit: ClassVar[str] = "um"
    internal_rate: ClassVar[float] = 400e3

    delay: float  # Delay of the drive's electronics, s
    amplifier_cutoff: float  # First-order cutoff, Hz
    elastic_slope: float  # Slope right after a reversal, um/V
    slip_slope: float  # Slope added once every slip element moves, um/V
    slip_elements: int  # Number of elements
    slip_range: float  # Largest half-width of a slack, V
    slip_decay: float  # Voltage over which the density of the elements falls to 1/e, V
    stroke: float  # Stroke to which saturation refers, um
    saturation: float  # Fraction of the stroke by which the curve is bent down at full stroke
    # drag_rise, drag_fall: Relaxation times at high polarization while it rises and falls, s
    drag_rise: float
    drag_fall: float
    drag_level: float  # Polarization at which half of that is reached, um
    mode_frequency: float  # Frequency of the flexure mode, Hz
    mode_damping: float  # Its damping ratio
    slow_share: float  # Fraction of the stroke that arrives late
    slow_time: float  # Time constant of its arrival, s
    sensor_cutoff: float  # First-order cutoff, Hz
    noise: float  # White noise, um rms

    def __post_init__(self) -> None:
        check_positive(self, POSITIVE)

    def parts(self, axis: int, frame: Frame, hysteresis: Mapping[str, float], moving: Mapping[str, Any]) -> dict[str, list[Part]]:
        slip = Slip(
            self.elastic_slope,
            self.slip_slope,
            int(self.slip_elements),
            self.slip_range,
            self.slip_decay,
            self.saturation / self.stroke,
            hysteresis.get("width", 0.0),
        )
        delay = Delay(self.delay + moving.get("delay", 0.0), frame.step)
        drag = Drag(self.drag_rise, self.drag_fall, self.drag_level, hysteresis.get("rate", 1.0), frame.step)
        return {
            "drive": [delay],
            "amplifier": [Held(exact_discretization.lag(2 * np.pi * self.amplifier_cutoff), frame.step)],
            "hysteresis": [Chain(slip, drag)],
            "mechanics": [mechanics(self._system, frame, moving, delay.rest)],
            "sensor": [Straight(exact_discretization.lag(2 * np.pi * self.sensor_cutoff), frame.step)],
        }

    def _system(self, mass_ratio: float, frequency_ratio: float) -> System:
        return exact_discretization.series(
            oscillator(self.mode_frequency, self.mode_damping, mass_ratio, frequency_ratio),
            exact_discretization.slow_share(self.slow_share, self.slow_time),
        )


class Drag(Part):
    """Viscous drag P' = (Y - P) / T(Y), with Y held over a step; the output is the mean of P over the step."""

    def __init__(self, rise: float, fall: float, level: float, factor: float, step: float) -> None:
        self._law = np.array([rise * factor, fall * factor, level, step])
        self._state = np.zeros(1)

    def settle(self, value: float) -> float:
        """Rest at a constant polarization."""
        self._state[0] = value
        return value

    def process(self, block: Array) -> Array:
        """Let the output relax toward a block of polarizations."""
        output = np.empty(block.size)
        _drag(block, self._law, self._state, output)
        return output


@njit(cache=True, error_model="numpy")
def _drag(block: Array, law: Array, state: Array, output: Array) -> None:
    rise, fall, level, step = law
    polarization = state[0]
    for k in range(block.size):
        wanted = block[k]
        time = (rise if wanted > polarization else fall) * abs(wanted) / (abs(wanted) + level)
        gone = 0.0
        if time > 1e-3 * step:
            gone = (polarization - wanted) * (1.0 - np.exp(-step / time))
            polarization -= gone
        else:
            polarization = wanted
        output[k] = wanted + gone * time / step
    state[0] = polarization
