# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A narrow-band disturbance that moves what is measured."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.chain.c_code.c_code import CCode, each_axis
from hyst_control.chain.parameter import ScalarPerAxis, Scattering, scalar
from hyst_control.chain.stage import per_axis_scalars, register
from hyst_control.effects.effect import Effect, Line, Parameter, RecordCheck, Surroundings
from hyst_control.effects.time_dependent import TimedStage


@register
@dataclass(frozen=True)
class Vibration(TimedStage):
    """y = u + amplitude sin(2π frequency t + phase), t from the start of the record.

    amplitude in the measurement unit, frequency Hz, phase rad.
    """

    name: ClassVar[str] = "vibration"
    equation: ClassVar[str] = r"y(t) = u(t) + \mathrm{amplitude}\, \sin\left(2 \pi\, \mathrm{frequency}\, t + \mathrm{phase}\right)"
    place: ClassVar[str] = "motion"
    amplitude: ScalarPerAxis = scalar("measurement unit", "of the fundamental")
    frequency: ScalarPerAxis = scalar("Hz", "of the disturbance", above=0.0)
    phase: ScalarPerAxis = scalar("rad", "at the start of the record", default=0.0, scatter=Scattering.ABSOLUTE)

    def function(self, axes: int) -> Callable[[Array, Array], Array]:
        amplitude, frequency, phase = per_axis_scalars(self, axes, "amplitude", "frequency", "phase")
        return lambda u, t: u + amplitude * np.sin(2 * np.pi * frequency * t + phase)

    def function_in_c(self, axes: int) -> CCode:
        amplitude, frequency, phase = per_axis_scalars(self, axes, "amplitude", "frequency", "phase")
        return each_axis(
            "u + (p->amplitude[i] * (real)sin((p->rate[i] * t) + p->phase[i]))",
            "vibration",
            {"amplitude": (amplitude, "measurement unit")},
            wide={"rate": (2 * np.pi * frequency, "rad/s"), "phase": (phase, "rad")},
        )


def parameters(around: Surroundings) -> tuple[Parameter, ...]:
    """A line has a narrow basin: fits begin at many frequencies."""
    nyquist = 0.5 / around.sample_time
    starts = tuple(np.geomspace(min(10.0, 0.1 * nyquist), 0.8 * nyquist, 8))
    size = around.stroke
    return (
        Parameter("amplitude", "unit", 0.0, (0.005 * size,), -0.5 * size, 0.5 * size, 0.01 * size),
        Parameter("frequency", "Hz", starts[4], starts, min(1.0, 0.05 * nyquist), 0.98 * nyquist, 1.5, True),
    )


EFFECT = Effect(
    "vibration",
    "motion",
    "A disturbance of one frequency moves the mechanics or the sensor's head.",
    parameters,
    lambda values, around: Vibration(values["amplitude"], values["frequency"], values.get("phase", 0.0)),
    line=Line(swells=24, skirt=0.05, overtones=(2, 3)),
    further_lines=(Line(skirt=0.05, overtones=(2, 3)), Line(harmonics=(1, 2, 3), swells=6, skirt=0.05)),
    record_check=RecordCheck.SPECTRAL_LINE,
    random_check=RecordCheck.SPECTRAL_HUMP,
    phrase="vibration at {frequency}",
)
