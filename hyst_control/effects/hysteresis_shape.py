# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The single-valued curve of the hysteresis, bent."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.chain.c_code.c_code import CCode, each_axis
from hyst_control.chain.chain import Chain, Parallel
from hyst_control.chain.memoryless import Memoryless
from hyst_control.chain.parameter import ScalarPerAxis, Scattering, scalar
from hyst_control.chain.stage import Modifier, Sampling, Stage, per_axis_scalar, per_axis_scalars, register
from hyst_control.effects.effect import Effect, Parameter, Surroundings, Values
from hyst_control.effects.placement import hysteresis_index

REACH, USUAL = 0.25, 0.05  # Largest and usual bend, in shares of the stroke
CUBIC = 12.0 * float(np.sqrt(3.0))  # Makes the cubic 1 at its greatest
BEND = """
static real bend_value(real x, real even, real odd, real tilt, real stroke)
{
    const real aside = x - R(0.5);
    const real rest = R(1.0) - x;
    return stroke * ((((even * x) * rest) + (((odd * x) * rest) * aside)) + (tilt * aside));
}
"""
BENT = "bend_value((u - p->{}[i]) / p->span[i], p->even[i], p->odd[i], p->tilt[i], p->stroke[i])"


@register
@dataclass(frozen=True)
class HysteresisShape(Modifier):
    """Adds a curve to the hysteresis before it, in shares of its stroke.

    With x = (u - lower) / (upper - lower), u its input, it is

        amount · 4 x (1 - x) + odd · 20.78 x (1 - x) (x - 1/2) + tilt · (x - 1/2)

    where amount and odd are the greatest distance from 0, and tilt the change from end to end. lower, upper V; stroke in the
    hysteresis' own output unit, by default what it settles at for `upper` less that for `lower`. With `behind` the curve is one of
    the hysteresis' output, from what that settles at for `lower` to what it does for `upper`.
    """

    name: ClassVar[str] = "hysteresis_shape"
    equation: ClassVar[str] = (
        r"\frac{\Delta y}{\mathrm{stroke}} = 4\, \mathrm{amount}\, x (1 - x) + 20.78\, \mathrm{odd}\, x (1 - x) \left(x - "
        r"\frac{1}{2}\right) + \mathrm{tilt} \left(x - \frac{1}{2}\right), \quad x = \frac{u - "
        r"\mathrm{lower}}{\mathrm{upper} - \mathrm{lower}}"
    )
    place: ClassVar[str] = "hysteresis"
    amount: ScalarPerAxis = scalar("", "of the stroke, midway")
    lower: ScalarPerAxis = scalar("V", "where the bend begins")
    upper: ScalarPerAxis = scalar("V", "where the bend ends")
    stroke: ScalarPerAxis | None = scalar("output unit", "default that of the hysteresis", default=None)
    odd: ScalarPerAxis = scalar("", "of the stroke, a fifth from either end", default=0.0)
    tilt: ScalarPerAxis = scalar("", "of the stroke, from end to end", default=0.0)
    behind: ScalarPerAxis = scalar(
        "", "1: a curve of the output", default=0.0, lower=0.0, upper=1.0, whole=True, scatter=Scattering.NONE
    )

    def check(self) -> None:
        if np.any(np.array(self.lower) >= np.array(self.upper)):
            raise InputError(f"lower: {self.lower} is not below upper {self.upper}")

    def applied(self, before: tuple[Stage, ...], axes: int) -> tuple[Stage, ...]:
        index = hysteresis_index(before)
        if index is None:
            raise InputError("hysteresis_shape: no hysteresis before it that it could bend: put it behind one")
        amount, odd, tilt, lower, upper = per_axis_scalars(self, axes, "amount", "odd", "tilt", "lower", "upper")
        if not (amount.any() or odd.any() or tilt.any()):
            return before
        begin, end = (Chain((before[index],)).filter(Sampling(1e-4, axes)).settle(value) for value in (lower, upper))
        span = end - begin
        stroke = span if self.stroke is None else per_axis_scalar(self.stroke, axes, "stroke")
        behind = per_axis_scalar(self.behind, axes, "behind")

        def curve(x: Array) -> Array:
            return stroke * bend_at(x, amount, odd, tilt)

        stages: tuple[Stage, ...] = (before[index],)
        bend = {
            "even": (amount * 4.0, "share of the stroke, four times the even bend midway"),
            "odd": (odd * CUBIC, "share of the stroke, of the cubic"),
            "tilt": (tilt, "share of the stroke, from end to end"),
            "stroke": (stroke, "output unit"),
        }

        def code(expression: str, title: str, **constants: tuple[Array, str]) -> CCode:
            return each_axis(expression, title, {**bend, **constants}, (BEND,))

        if not behind.all():
            text = code(
                f"p->share[i] * {BENT.format('lower')}",
                "bend",
                share=(1.0 - behind, "0 where the bend is one of the output"),
                lower=(lower, "V, where the bend begins"),
                span=(upper - lower, "V"),
            )
            bent = Memoryless(lambda u: (1.0 - behind) * curve((u - lower) / (upper - lower)), text)
            stages = (Parallel(((before[index],), (bent,))),)
        if behind.any():
            whole = np.where(span, span, 1.0)
            text = code(
                f"u + (p->share[i] * {BENT.format('begin')})",
                "bend behind",
                share=(behind, "0 where the bend is one of the command"),
                begin=(begin, "output unit, where the bend begins"),
                span=(whole, "output unit"),
            )
            stages = (*stages, Memoryless(lambda y: y + behind * curve((y - begin) / whole), text))
        return (*before[:index], *stages, *before[index + 1 :])


def bend_at(x: Array, even: Array, odd: Array, tilt: Array) -> Array:
    """Height of a bend, in shares of the stroke."""
    return even * 4.0 * x * (1.0 - x) + odd * CUBIC * x * (1.0 - x) * (x - 0.5) + tilt * (x - 0.5)


def peak(values: Values) -> dict[str, float]:
    """Amount of a curve: its greatest distance from 0, with its sign there, in shares of the stroke."""
    curve = bend_at(np.linspace(0.0, 1.0, 101), values["even"], values["odd"], values["tilt"])
    return {"amount": float(curve[np.argmax(np.abs(curve))])}


def shape(values: Values, around: Surroundings) -> HysteresisShape:
    """The curve over the record's range of command; of `amount` alone the even one."""
    lower, upper = around.command
    even = values["even"] if "even" in values else values["amount"]
    odd, tilt, behind = values.get("odd", 0.0), values.get("tilt", 0.0), values.get("behind", 0.0)
    return HysteresisShape(even, lower, max(upper, lower + 1e-6), odd=odd, tilt=tilt, behind=behind)


EFFECT = Effect(
    "hysteresis_shape",
    "hysteresis",
    "The single-valued curve under the loops is bent, evenly or oddly, or tilted.",
    lambda around: (
        Parameter("even", "", 0.0, (0.005,), -REACH, REACH, USUAL, told=False),
        Parameter("odd", "", 0.0, (0.0,), -REACH, REACH, USUAL, told=False, is_size=True),
        Parameter("tilt", "", 0.0, (0.0,), -2.0 * REACH, 2.0 * REACH, 1.5 * USUAL, told=False, is_size=True),
        Parameter("behind", "", 0.0, (0.0, 1.0), 0.0, 1.0, 1.0, told=False),
    ),
    shape,
    variants=lambda around: ({"behind": 0.0}, {"tilt": 0.0, "behind": 1.0}),
    summary=peak,
    exercised=lambda around: around.command[1] > around.command[0],
    phrase="a bent or tilted hysteresis",
)
