# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The mains in the sensor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.chain.c_code.c_code import CCode, each_axis
from hyst_control.chain.parameter import ScalarPerAxis, Scattering, scalar
from hyst_control.chain.stage import per_axis_scalars, register
from hyst_control.effects.effect import Effect, Line, Parameter, RecordCheck
from hyst_control.effects.time_dependent import TimedStage

HUM = """
static double hum_value(double angle)
{
    return (sin(angle) + (0.3 * sin(3.0 * angle))) + (0.1 * sin(5.0 * angle));
}
"""


@register
@dataclass(frozen=True)
class MainsHum(TimedStage):
    """y = u + amplitude (sin φ + 0.3 sin 3φ + 0.1 sin 5φ), φ = 2π frequency t + phase; t from the start of the record.

    amplitude in the measurement unit, frequency Hz, phase rad.
    """

    name: ClassVar[str] = "mains_hum"
    equation: ClassVar[str] = (
        r"y(t) = u(t) + \mathrm{amplitude} \left(\sin \varphi + 0.3 \sin 3 \varphi + 0.1 \sin 5 \varphi\right), \quad "
        r"\varphi = 2 \pi\, \mathrm{frequency}\, t + \mathrm{phase}"
    )
    amplitude: ScalarPerAxis = scalar("measurement unit", "of the fundamental")
    frequency: ScalarPerAxis = scalar("Hz", "of the mains", default=50.0, above=0.0)
    phase: ScalarPerAxis = scalar("rad", "at the start of the record", default=0.0, scatter=Scattering.ABSOLUTE)

    def function(self, axes: int) -> Callable[[Array, Array], Array]:
        amplitude, frequency, phase = per_axis_scalars(self, axes, "amplitude", "frequency", "phase")

        def hum(u: Array, t: Array) -> Array:
            angle = 2 * np.pi * frequency * t + phase
            return u + amplitude * (np.sin(angle) + 0.3 * np.sin(3.0 * angle) + 0.1 * np.sin(5.0 * angle))

        return hum

    def function_in_c(self, axes: int) -> CCode:
        amplitude, frequency, phase = per_axis_scalars(self, axes, "amplitude", "frequency", "phase")
        return each_axis(
            "u + (p->amplitude[i] * (real)hum_value((p->rate[i] * t) + p->phase[i]))",
            "mains hum",
            {"amplitude": (amplitude, "measurement unit")},
            (HUM,),
            {"rate": (2 * np.pi * frequency, "rad/s"), "phase": (phase, "rad")},
        )


EFFECT = Effect(
    "mains_hum",
    "sensor",
    "The mains and its harmonics come into the measurement.",
    lambda around: (
        Parameter(
            "amplitude", "unit", 0.0, (0.005 * around.stroke,), -0.5 * around.stroke, 0.5 * around.stroke, 0.01 * around.stroke
        ),
        Parameter("frequency", "Hz", 50.0, (50.0, 60.0), 45.0, 65.0, 1.0),
    ),
    lambda values, around: MainsHum(values["amplitude"], values["frequency"], values.get("phase", 0.0)),
    exercised=lambda around: 0.5 / around.sample_time > 65.0,
    line=Line(harmonics=(1, 2, 3, 4, 5, 6, 7)),
    further_lines=(Line(),),
    record_check=RecordCheck.MAINS_LINE,
    phrase="mains hum at {frequency}",
)
