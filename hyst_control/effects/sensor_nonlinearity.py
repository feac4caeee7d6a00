# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A bent characteristic of the sensor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.chain.c_code.c_code import MAXIMUM, MINIMUM, each_axis
from hyst_control.chain.c_code.texts import c_texts
from hyst_control.chain.memoryless import StaticFilter
from hyst_control.chain.parameter import ScalarPerAxis, Scattering, scalar
from hyst_control.chain.stage import Filter, Sampling, Stage, frozen, per_axis_scalars, register
from hyst_control.effects.effect import Effect, Parameter, Surroundings, Values

C = c_texts(__file__)


@register
@dataclass(frozen=True)
class SensorNonlinearity(Stage):
    """y = u + zero + first P1(x) + … + fifth P5(x), Legendre polynomials of x = 2 (u - lower) / (upper - lower) - 1; measurement unit."""

    name: ClassVar[str] = "sensor_nonlinearity"
    equation: ClassVar[str] = (
        r"y = u + \mathrm{zero} + \mathrm{first}\, P_1(x) + \mathrm{second}\, P_2(x) + \mathrm{third}\, P_3(x) + "
        r"\mathrm{fourth}\, P_4(x) + \mathrm{fifth}\, P_5(x), \quad x = 2\, \frac{u - \mathrm{lower}}{\mathrm{upper} - "
        r"\mathrm{lower}} - 1"
    )
    second: ScalarPerAxis = scalar("measurement unit", "factor of P2")
    third: ScalarPerAxis = scalar("measurement unit", "factor of P3")
    lower: ScalarPerAxis = scalar("measurement unit", "where x is -1")
    upper: ScalarPerAxis = scalar("measurement unit", "where x is 1")
    zero: ScalarPerAxis = scalar("measurement unit", "constant", default=0.0, scatter=Scattering.ABSOLUTE)
    fourth: ScalarPerAxis = scalar("measurement unit", "factor of P4", default=0.0, scatter=Scattering.ABSOLUTE)
    fifth: ScalarPerAxis = scalar("measurement unit", "factor of P5", default=0.0, scatter=Scattering.ABSOLUTE)
    first: ScalarPerAxis = scalar("measurement unit", "factor of P1", default=0.0, scatter=Scattering.ABSOLUTE)

    def check(self) -> None:
        if np.any(np.array(self.lower) >= np.array(self.upper)):
            raise InputError(f"lower: {self.lower} is not below upper {self.upper}")

    def filter(self, sampling: Sampling) -> Filter:
        second, third, lower, upper, zero = per_axis_scalars(self, sampling.axes, "second", "third", "lower", "upper", "zero")
        fourth, fifth, first = per_axis_scalars(self, sampling.axes, "fourth", "fifth", "first")
        higher = bool(fourth.any() or fifth.any() or first.any())

        def bent(u: Array) -> Array:
            x = 2.0 * (u - lower) / (upper - lower) - 1.0
            bend = second * 0.5 * (3.0 * x * x - 1.0) + third * 0.5 * (5.0 * x * x - 3.0) * x + zero
            if higher:
                square = np.clip(x * x, 0.0, 2.25)  # beyond its range the curve goes on straight enough not to run away
                bend = bend + fourth * ((35.0 * square - 30.0) * square + 3.0) / 8.0
                bend = bend + fifth * ((63.0 * square - 70.0) * square + 15.0) * x / 8.0 + first * x
            return u + bend

        unit = "measurement unit"
        constants = {"second": second, "third": third, "lower": lower, "upper": upper, "zero": zero}
        bend = "bent_value(u, p->lower[i], p->upper[i], p->second[i], p->third[i], p->zero[i])"
        functions: tuple[str, ...] = (C["BENT"],)
        if higher:
            constants |= {"fourth": fourth, "fifth": fifth, "first": first}
            bend = f"higher_bend({bend}, u, p->lower[i], p->upper[i], p->fourth[i], p->fifth[i], p->first[i])"
            functions = (C["BENT"], MAXIMUM, MINIMUM, C["HIGHER"])
        code = each_axis(
            f"u + {bend}", "sensor nonlinearity", {name: (value, unit) for name, value in constants.items()}, functions
        )
        return StaticFilter(bent, sampling.hold, code)


def parameters(around: Surroundings) -> tuple[Parameter, ...]:
    """second, third: up to the stroke, fourth, fifth: up to 40 % of it; no bend is larger than what is measured.

    The terms are polynomials over the sensor's own range, which is unknown. Over the record's range the same curve also has a constant and
    a slope. ratio and slope are these, divided by the norm of (second, third), so that an offset or a gain alone is no nonlinearity.
    """
    size = around.stroke
    return (
        *(Parameter(name, "unit", 0.0, (0.002 * size,), -size, size, 0.05 * size, is_size=True) for name in ("second", "third")),
        Parameter("ratio", "", 0.0, (0.0,), -8.0, 8.0, 2.0, told=False),
        *(Parameter(name, "unit", 0.0, (0.0,), -0.4 * size, 0.4 * size, 0.01 * size, told=False) for name in ("fourth", "fifth")),
        Parameter("slope", "", 0.0, (0.0,), -8.0, 8.0, 2.0, told=False),
    )


def variants(around: Surroundings) -> tuple[Values, ...]:
    """All terms, and the second and third alone: more are not identifiable beside a model discrepancy."""
    return {}, {"ratio": 0.0, "fourth": 0.0, "fifth": 0.0, "slope": 0.0}


def stage(values: Values, around: Surroundings) -> SensorNonlinearity:
    """Bend over the range that the model simulates, or else that of the measurement, unless `lower` and `upper` are among the values."""
    # The range of the characteristic is that of its input: a large bend moves the ends of what is measured.
    lower, upper = around.measurement if around.modeled is None else around.modeled
    lower, upper = values.get("lower", lower), values.get("upper", max(upper, lower + 1e-9))
    bend = np.hypot(values["second"], values["third"])
    zero, first = (frozen(np.multiply(values.get(name, 0.0), bend)) for name in ("ratio", "slope"))
    fourth, fifth = values.get("fourth", 0.0), values.get("fifth", 0.0)
    return SensorNonlinearity(values["second"], values["third"], lower, upper, zero, fourth, fifth, first)


EFFECT = Effect(
    "sensor_nonlinearity",
    "sensor",
    "The sensor's characteristic is bent.",
    parameters,
    stage,
    variants=variants,
    exercised=lambda around: around.stroke > 0,
    phrase="a sensor nonlinearity",
)
