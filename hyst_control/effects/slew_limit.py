# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A driver that follows no faster than a rate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import njit

from hyst_control.base.arrays import Array
from hyst_control.chain.c_code.c_code import CCode, reals
from hyst_control.chain.c_code.texts import c_texts
from hyst_control.chain.parameter import ScalarPerAxis, scalar
from hyst_control.chain.stage import Filter, Sampling, Stage, frozen, per_axis_scalar, register
from hyst_control.effects.effect import Effect, Parameter, Surroundings, Values

C = c_texts(__file__)


@register
@dataclass(frozen=True)
class SlewLimit(Stage):
    """Follows its input no faster than `rate` (V/s); infinite: not limited.

    Of a held input the output runs up to it within the interval; it is handed on held at its mean over the interval, which
    is right to second order in the sample time for what is linear behind it.
    """

    name: ClassVar[str] = "slew_limit"
    equation: ClassVar[str] = r"|\dot{y}| \leq \mathrm{rate}"
    place: ClassVar[str] = "drive"
    only_limits: ClassVar[bool] = True
    rate: ScalarPerAxis = scalar("V/s", "greatest slope of the output", above=0.0, infinite=True)
    falling: ScalarPerAxis | None = scalar("V/s", "the same of a falling output", default=None, above=0.0, infinite=True)

    def filter(self, sampling: Sampling) -> Filter:
        rising = per_axis_scalar(self.rate, sampling.axes, "rate")
        falling = rising if self.falling is None else per_axis_scalar(self.falling, sampling.axes, "falling")
        return SlewFilter(rising * sampling.sample_time, falling * sampling.sample_time, sampling.hold)


class SlewFilter(Filter):
    """Streaming `SlewLimit`; rising, falling: largest change (A,) up and down in a sample."""

    def __init__(self, rising: Array, falling: Array, hold: str) -> None:
        self.hold = hold
        self.rising, self.falling, self.state = rising, falling, np.zeros(len(rising))

    def settle(self, value: Array) -> Array:
        self.state[:] = value
        return self.state.copy()

    def process(self, block: Array) -> Array:
        output = np.empty_like(block)
        follow(block, self.rising, self.falling, self.hold == "zoh", self.state, output)
        return output

    def c_code(self) -> CCode:
        return CCode(
            "slew limit",
            C["STEP"],
            "for (int i = 0; i < AXES; i++) {\n    s->value[i] = in[i];\n    out[i] = in[i];\n}",
            {"MEAN": int(self.hold == "zoh")},
            {
                "rising": reals(self.rising, "signal unit, largest rise in a sample"),
                "falling": reals(self.falling, "signal unit, largest fall in a sample"),
            },
            {"value": reals(self.state, "signal unit, at the end of the interval")},
        )


@njit(cache=True, error_model="numpy")
def follow(block: Array, rising: Array, falling: Array, mean: bool, state: Array, output: Array) -> None:
    """block, output (N, A); rising, falling (A,) a sample; state (A,), the value at the end of an interval, is updated.

    mean: the output is the mean over the interval, in which the value runs up to a held input, else the value at its end.
    """
    for row in range(block.shape[0]):
        for axis in range(block.shape[1]):
            distance = block[row, axis] - state[axis]
            most = rising[axis] if distance > 0.0 else falling[axis]
            if abs(distance) <= most:
                state[axis] = block[row, axis]
                output[row, axis] = state[axis] - (0.5 * distance * abs(distance) / most if mean else 0.0)
            else:
                step = most if distance > 0.0 else -most
                state[axis] += step
                output[row, axis] = state[axis] - (0.5 * step if mean else 0.0)


def parameters(around: Surroundings) -> tuple[Parameter, ...]:
    """Rates that the command exceeds, ratio of falling to rising one, and sides: 0 both limited, 1 rising alone, 2 falling alone."""
    # The misfit of a rate that a loop often meets is low only close to it: the nearer the command's largest rate, the closer they are.
    shares = (0.93, 0.86, 0.78, 0.69, 0.6, 0.5, 0.41, 0.33, 0.25, 0.17, 0.1, 0.06, 0.03, 0.01, 0.003)
    starts = tuple(share * around.slew for share in shares)
    return (
        Parameter("rate", "command/s", np.inf, starts, 1e-3 * around.slew, around.slew, 1.5, True),
        Parameter("ratio", "", 1.0, (1.0,), 0.1, 10.0, 0.5, True, told=False),
        Parameter("sides", "", 0.0, (0.0, 1.0, 2.0), 0.0, 2.0, 1.0, told=False),
    )


def stage(values: Values, around: Surroundings) -> SlewLimit:
    """The limit of the directions that `sides` says."""
    rate, sides = np.array(values["rate"], dtype=float), np.array(values.get("sides", 0.0))
    falling = np.where(sides == 1.0, np.inf, rate * np.array(values.get("ratio", 1.0)))
    return SlewLimit(frozen(np.where(sides == 2.0, np.inf, rate)), frozen(falling))


EFFECT = Effect(
    "slew_limit",
    "drive",
    "The driver follows the command no faster than a rate.",
    parameters,
    stage,
    variants=lambda around: ({"sides": 0.0}, {"ratio": 1.0, "sides": 1.0}, {"ratio": 1.0, "sides": 2.0}),
    exercised=lambda around: bool(np.isfinite(around.slew) and around.slew > 0),
    phrase="a slew limit of {rate}",
)
