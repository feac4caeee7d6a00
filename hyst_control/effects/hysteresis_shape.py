"""The single-valued curve of the hysteresis, bent."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hyst_control.chain.c_code import each_axis
from hyst_control.chain.memoryless import Memoryless
from hyst_control.chain.parameter import Array, ScalarPerAxis, scalar
from hyst_control.chain.stage import Modifier, Stage, per_axis_scalar, per_axis_scalars, register
from hyst_control.effects.effect import Effect, Parameter
from hyst_control.effects.modifiers import beside, settled
from hyst_control.effects.placement import hysteresis_index
from hyst_control.errors import InputError

BEND = """
static real bend_value(real x, real height)
{
    return (height * x) * (R(1.0) - x);
}
"""


@register
@dataclass(frozen=True)
class HysteresisShape(Modifier):
    """Adds amount · stroke · 4 x (1 - x) with x = (u - lower) / (upper - lower) to the hysteresis before it, u its input.

    lower, upper V; stroke in the hysteresis' own output unit, by default what it settles at for `upper` less that for `lower`.
    """

    name: ClassVar[str] = "hysteresis_shape"
    place: ClassVar[str] = "hysteresis"
    amount: ScalarPerAxis = scalar("", "of the stroke, midway")
    lower: ScalarPerAxis = scalar("V", "where the bend begins")
    upper: ScalarPerAxis = scalar("V", "where the bend ends")
    stroke: ScalarPerAxis | None = scalar("output unit", "default that of the hysteresis", default=None)

    def check(self) -> None:
        if np.any(np.array(self.lower) >= np.array(self.upper)):
            raise InputError(f"lower: {self.lower} is not below upper {self.upper}")

    def applied(self, before: tuple[Stage, ...], axes: int) -> tuple[Stage, ...]:
        index = hysteresis_index(before)
        if index is None:
            raise InputError("hysteresis_shape: no hysteresis before it that it could bend: put it behind one")
        amount, lower, upper = per_axis_scalars(self, axes, "amount", "lower", "upper")
        if not np.any(amount):
            return before
        if self.stroke is None:
            stroke = settled(before[index], upper) - settled(before[index], lower)
        else:
            stroke = per_axis_scalar(self.stroke, axes, "stroke")

        def bend(u: Array) -> Array:
            x = (u - lower) / (upper - lower)
            return amount * stroke * 4.0 * x * (1.0 - x)

        code = each_axis(
            "bend_value((u - p->lower[i]) / p->span[i], p->height[i])",
            "bend",
            {
                "lower": (lower, "V, where the bend begins"),
                "span": (upper - lower, "V"),
                "height": (amount * stroke * 4.0, "output unit, four times the bend midway"),
            },
            (BEND,),
        )
        return (*before[:index], beside(before[index], Memoryless(bend, code)), *before[index + 1 :])


EFFECT = Effect(
    "hysteresis_shape",
    "hysteresis",
    "The single-valued curve under the loops is bent.",
    lambda around: (Parameter("amount", "", 0.0, (0.005,), -0.1, 0.1, 0.02),),
    lambda values, around: HysteresisShape(values["amount"], around.command[0], max(around.command[1], around.command[0] + 1e-6)),
    exercised=lambda around: around.command[1] > around.command[0],
)
