# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A gap in a joint of the mechanics: part of the spring acts beyond it only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from hyst_control.chain.parameter import ScalarPerAxis, scalar
from hyst_control.chain.stage import Modifier, Stage, per_axis_scalars, register
from hyst_control.effects.effect import Effect, Parameter, Surroundings
from hyst_control.effects.restoring_force import GAP, with_force


@register
@dataclass(frozen=True)
class Clearance(Modifier):
    """Lets the mechanics before it move further by what a spring loses in a gap of ± half_width: by `excess` at its ends and beyond.

    Negative where a preload holds the motion within the gap.
    """

    name: ClassVar[str] = "clearance"
    equation: ClassVar[str] = (
        r"y = G(s) \left(u + \frac{\mathrm{excess}}{G(0)} \min\left(\max\left(\frac{y}{\mathrm{half\_width}}, -1\right), 1\right)\right)"
    )
    place: ClassVar[str] = "motion"
    half_width: ScalarPerAxis = scalar("measurement unit", "of the gap, to either side of 0", above=0.0)
    excess: ScalarPerAxis = scalar("measurement unit", "motion that the drive gains beyond the gap")

    def applied(self, before: tuple[Stage, ...], axes: int) -> tuple[Stage, ...]:
        excess, half_width = per_axis_scalars(self, axes, "excess", "half_width")
        return with_force(self.name, before, GAP, excess, half_width)


def parameters(around: Surroundings) -> tuple[Parameter, ...]:
    """Gap up to the whole motion, excess up to a quarter of it."""
    size = max(around.stroke, 1e-9)
    return (
        Parameter("excess", "unit", 0.0, (0.01 * size, 0.01 * size), -0.25 * size, 0.25 * size, 0.02 * size),
        Parameter("half_width", "unit", 0.2 * size, (0.02 * size, 0.2 * size), 1e-3 * size, 0.5 * size, 1.0, logarithmic=True),
    )


EFFECT = Effect(
    "clearance",
    "motion",
    "A joint of the mechanics has a gap in which part of the stiffness is lost.",
    parameters,
    lambda values, around: Clearance(values["half_width"], values["excess"]),
    exercised=lambda around: around.measurement[0] < 0.0 < around.measurement[1],
    phrase="a clearance of ±{half_width} in the mechanics",
)
