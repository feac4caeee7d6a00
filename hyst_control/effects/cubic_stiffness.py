# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A spring that stiffens or softens with the cube of the displacement."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from hyst_control.chain.parameter import ScalarPerAxis, scalar
from hyst_control.chain.stage import Modifier, Stage, per_axis_scalars, register
from hyst_control.effects.effect import Effect, Parameter, Surroundings
from hyst_control.effects.restoring_force import CUBIC, with_force


@register
@dataclass(frozen=True)
class CubicStiffness(Modifier):
    """Takes a force by the cube of the displacement off the mechanics before it; negative where the spring softens.

    At `amplitude` it moves the mechanics at rest by `loss`.
    """

    name: ClassVar[str] = "cubic_stiffness"
    equation: ClassVar[str] = r"y = G(s) \left(u - \frac{\mathrm{loss}}{G(0)} \left(\frac{y}{\mathrm{amplitude}}\right)^3\right)"
    place: ClassVar[str] = "motion"
    loss: ScalarPerAxis = scalar("measurement unit", "motion that the cube takes at the amplitude")
    amplitude: ScalarPerAxis = scalar("measurement unit", "of the motion", above=0.0)

    def applied(self, before: tuple[Stage, ...], axes: int) -> tuple[Stage, ...]:
        loss, amplitude = per_axis_scalars(self, axes, "loss", "amplitude")
        return with_force(self.name, before, CUBIC, loss, amplitude)


def amplitude(around: Surroundings) -> float:
    """Farthest that the record moves from 0, measurement unit."""
    return max(abs(around.measurement[0]), abs(around.measurement[1]), 1e-300)


def parameters(around: Surroundings) -> tuple[Parameter, ...]:
    """Up to a third of the motion at the farthest point: beyond, a softening spring lets go."""
    size = amplitude(around)
    return (Parameter("loss", "unit", 0.0, (0.02 * size, -0.02 * size), -0.33 * size, 0.33 * size, 0.05 * size),)


EFFECT = Effect(
    "cubic_stiffness",
    "motion",
    "The spring of the mechanics stiffens, or softens, with the cube of the displacement.",
    parameters,
    lambda values, around: CubicStiffness(values["loss"], values.get("amplitude", amplitude(around))),
    phrase="a cubic stiffness that takes {loss} at the farthest point",
)
