# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Coulomb friction in the mechanics; viscous friction is damping, which the linear mechanics have."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hyst_control.chain.parameter import ScalarPerAxis, Scattering, scalar
from hyst_control.chain.stage import Modifier, Stage, per_axis_scalars, register
from hyst_control.effects.effect import Effect, Parameter, Surroundings
from hyst_control.effects.restoring_force import FRICTION, SPEED_FRICTION, with_force


@register
@dataclass(frozen=True)
class DryFriction(Modifier):
    """Holds the mechanics before it back by a constant force against their speed; at rest by as much as stops them.

    `slack` is what the force moves the mechanics by at rest. With `speed` the output is the speed itself, else the position. Every step
    takes the force that leaves the motion where it is, as it is at the step's end and would be a step later at its speed, and no more than
    the friction: sticking needs no tolerance.
    """

    name: ClassVar[str] = "dry_friction"
    equation: ClassVar[str] = r"y = G(s) \left(u - \frac{\mathrm{slack}}{G(0)}\, \mathrm{sign}\, \dot{y}\right)"
    place: ClassVar[str] = "motion"
    slack: ScalarPerAxis = scalar("measurement unit", "motion that the friction holds back", lower=0.0)
    speed: ScalarPerAxis = scalar(
        "", "1: the output is a speed", default=0.0, lower=0.0, upper=1.0, whole=True, scatter=Scattering.NONE
    )

    def applied(self, before: tuple[Stage, ...], axes: int) -> tuple[Stage, ...]:
        slack, speed = per_axis_scalars(self, axes, "slack", "speed")
        return with_force(self.name, before, SPEED_FRICTION if speed.all() else FRICTION, slack, np.ones(axes))


def parameters(around: Surroundings) -> tuple[Parameter, ...]:
    """Friction up to half of the stroke."""
    size = around.stroke
    return (
        Parameter("slack", "unit", 0.0, (0.002 * size, 0.02 * size, 0.1 * size), 0.0, 0.5 * size, 0.02 * size),
        Parameter("speed", "", 0.0, (0.0, 1.0), 0.0, 1.0, 1.0, told=False),
    )


EFFECT = Effect(
    "dry_friction",
    "motion",
    "Dry friction holds the mechanics against the drive.",
    parameters,
    lambda values, around: DryFriction(values["slack"], values.get("speed", 0.0)),
    variants=lambda around: ({"speed": 0.0}, {"speed": 1.0}),
    repeats_values=True,
    phrase="dry friction that holds back {slack}",
)
