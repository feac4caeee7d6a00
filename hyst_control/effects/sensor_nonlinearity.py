"""A bent characteristic of the sensor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from hyst_control.chain.stage import Array, Filter, Sampling, Stage, per_axis_scalar, register, require_finite
from hyst_control.chain.static import StaticFilter
from hyst_control.effects.effect import Effect, Parameter, Surroundings, Values
from hyst_control.errors import InputError

WIDER, NARROWER = 1.0, 0.3
"""By how many times the stroke of a record the sensor's range may reach beyond it at either end, or fall short of it."""


@register
@dataclass(frozen=True)
class SensorNonlinearity(Stage):
    """y = u + second P2(x) + third P3(x), Legendre polynomials of x = 2 (u - lower) / (upper - lower) - 1; measurement unit."""

    name: ClassVar[str] = "sensor_nonlinearity"
    second: Any
    third: Any
    lower: Any
    upper: Any

    def check(self) -> None:
        for field in ("second", "third", "lower", "upper"):
            require_finite(getattr(self, field), field)
        if np.any(np.array(self.lower) >= np.array(self.upper)):
            raise InputError(f"lower: {self.lower} is not below upper {self.upper}")

    def filter(self, sampling: Sampling) -> Filter:
        second, third, lower, upper = (
            per_axis_scalar(getattr(self, field), sampling.axes, field) for field in ("second", "third", "lower", "upper")
        )

        def bent(u: Array) -> Array:
            x = 2.0 * (u - lower) / (upper - lower) - 1.0
            return u + second * 0.5 * (3.0 * x * x - 1.0) + third * 0.5 * (5.0 * x * x - 3.0) * x

        return StaticFilter(bent, sampling.hold)


def parameters(around: Surroundings) -> tuple[Parameter, ...]:
    """second, third: up to 5 % of the stroke; lower, upper: about the ends of the record.

    The terms belong to a range that nobody tells. Over another one the same bend has other terms, a constant among them, which would
    look like an offset.
    """
    size, (lower, upper) = around.stroke, _range(around)
    return (
        *(Parameter(name, "unit", 0.0, (0.002 * size,), -0.05 * size, 0.05 * size, 0.01 * size) for name in ("second", "third")),
        Parameter("lower", "unit", lower, (lower,), lower - WIDER * size, lower + NARROWER * size, 0.3 * size, told=False),
        Parameter("upper", "unit", upper, (upper,), upper - NARROWER * size, upper + WIDER * size, 0.3 * size, told=False),
    )


def _range(around: Surroundings) -> tuple[float, float]:
    lower, upper = around.measurement
    return lower, max(upper, lower + 1e-9)


def stage(values: Values, around: Surroundings) -> SensorNonlinearity:
    """Over the record's range of measurement, unless `lower` and `upper` are among the values."""
    lower, upper = _range(around)
    return SensorNonlinearity(values["second"], values["third"], values.get("lower", lower), values.get("upper", upper))


EFFECT = Effect(
    "sensor_nonlinearity",
    "sensor",
    "The sensor's characteristic is bent.",
    parameters,
    stage,
    exercised=lambda around: around.stroke > 0,
)
