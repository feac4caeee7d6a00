# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Play behind the mechanics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.chain.hysteresis.prandtl_ishlinskii import PlayFilter, PlayOperator
from hyst_control.chain.parameter import ScalarPerAxis, scalar
from hyst_control.chain.stage import Filter, Sampling, Stage, per_axis_scalars, register
from hyst_control.effects.effect import Effect, Parameter, Surroundings


@register
@dataclass(frozen=True)
class Backlash(Stage):
    """Follows its input with a play of `half_width` (measurement unit) to either side; starts from 0 like every play.

    With `start` it begins at u + start · half_width instead: -1 is where a rise, 1 where a fall has left it.
    """

    name: ClassVar[str] = "backlash"
    equation: ClassVar[str] = (
        r"y_k = \max\left(u_k - \mathrm{half\_width}, \min\left(u_k + \mathrm{half\_width}, y_{k-1}\right)\right)"
    )
    place: ClassVar[str] = "motion"
    half_width: ScalarPerAxis = scalar("measurement unit", "half of the play", lower=0.0)
    start: ScalarPerAxis | None = scalar("half-widths", "where in the play a record begins", default=None, lower=-1.0, upper=1.0)

    def filter(self, sampling: Sampling) -> Filter:
        running = PlayOperator(self.half_width).filter(sampling)
        if self.start is None:
            return running
        half_width, start = per_axis_scalars(self, sampling.axes, "half_width", "start")
        return BegunFilter(running, half_width * start)


class BegunFilter(Filter):
    """A play that begins at a distance (A,) from its input."""

    def __init__(self, running: PlayFilter, distance: Array) -> None:
        self.running, self.distance, self.hold = running, distance, running.hold

    def settle(self, value: Array) -> Array:
        self.running.settle(value)
        first: Array = np.array(value, dtype=float) + self.distance
        self.running.state[:, 0] = first
        return first

    def process(self, block: Array) -> Array:
        return self.running.process(block)


def parameters(around: Surroundings) -> tuple[Parameter, ...]:
    """Play up to half of the stroke, from several starts: a linear step from a narrow one says little of a wide one."""
    size = around.stroke
    return (
        Parameter("half_width", "unit", 0.0, (0.002 * size, 0.01 * size, 0.05 * size, 0.2 * size), 0.0, 0.5 * size, 0.05 * size),
        Parameter("start", "", 0.0, (-0.7, 0.7, -0.7, 0.7), -1.0, 1.0, 0.5, told=False),
        Parameter("begun", "", 0.0, (0.0, 1.0), 0.0, 1.0, 1.0, told=False),
    )


EFFECT = Effect(
    "backlash",
    "motion",
    "Something between mechanics and sensor has play.",
    parameters,
    lambda values, around: Backlash(values["half_width"], values["start"] if np.any(values.get("begun", 0.0)) else None),
    variants=lambda around: ({"start": 0.0, "begun": 0.0}, {"begun": 1.0}),
    phrase="backlash of ±{half_width}",
    repeats_values=True,
)
