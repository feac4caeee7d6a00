# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The width of the hysteresis: its memory part scaled, its single-valued mean curve kept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.chain import Chain, Sampling
from hyst_control.chain.hysteresis.prandtl_ishlinskii import PrandtlIshlinskii
from hyst_control.chain.memoryless import Offset
from hyst_control.chain.parameter import ScalarPerAxis, Scattering, scalar
from hyst_control.chain.stage import Modifier, Stage, frozen, per_axis_scalar, per_axis_scalars, register, replaced
from hyst_control.effects.effect import Effect, Parameter, Surroundings, Values
from hyst_control.effects.placement import hysteresis_index

OPERATORS, DENSER = 8, 1.5  # the exponent: a measured stack's nested loops
LEG = 200  # Rows from one end of the loop that the gap report's width is read from to the other


@register
@dataclass(frozen=True)
class HysteresisWidth(Modifier):
    """Scales the memory of the hysteresis before it by 1 + width; its mean curve stays.

    Of play operators `scaled` may be 1: their thresholds, or 2: the weights of all but the narrowest, with which the mean curve goes.

    The mean curve of a play operator H[u] is u, also under the dynamic weights of the modified Prandtl-Ishlinskii model; that of
    Madelung hysteresis is the mean of the two major branches.

    A chain without hysteresis gets one behind what is before. A chain whose hysteresis has no width to scale, as a Python function, gets
    one before that. It is u + c (mean of H_r[u] - u + 2 mean of r (u - centre) / span) over the
    play operators of `OPERATORS` thresholds r up to half of `span` (V), denser toward 0, with c such that a drive over the span, up
    and down about `centre` (V), gives a loop that opens by width span at its middle. Its ends stay where they were: they are what a
    model without hysteresis was fitted to.
    """

    name: ClassVar[str] = "hysteresis_width"
    equation: ClassVar[str] = r"y = \overline{H}[u] + (1 + \mathrm{width}) \left(H[u] - \overline{H}[u]\right)"
    place: ClassVar[str] = "hysteresis"
    adds_hysteresis: ClassVar[bool] = True
    width: ScalarPerAxis = scalar("", "growth of the loop's width")
    span: ScalarPerAxis = scalar("V", "of the drive, where a chain has no hysteresis", default=100.0, above=0.0)
    centre: ScalarPerAxis = scalar("V", "middle of the span", default=0.0)
    scaled: ScalarPerAxis = scalar(
        "", "0 the memory, 1 thresholds, 2 weights", default=0.0, lower=0.0, upper=2.0, whole=True, scatter=Scattering.NONE
    )

    def applied(self, before: tuple[Stage, ...], axes: int) -> tuple[Stage, ...]:
        width = per_axis_scalar(self.width, axes, "width")
        (what,) = per_axis_scalars(self, axes, "scaled")
        if what.any():
            thresholds, weights = (np.where(what == which, 1.0 + width, 1.0) for which in (1.0, 2.0))
            changed = replaced(before, lambda stage: stage.with_operators(thresholds, weights))
            if changed is None:
                raise InputError("scaled: needs a hysteresis of play operators: leave it out")
            before, width = changed, np.where(what == 0.0, width, 0.0)
            if not width.any():
                return before
        changed = replaced(before, lambda stage: stage.with_loop_width(width))
        if changed is None:  # no loop, or none that can be changed within: more of it goes before what has the hysteresis
            index = hysteresis_index(before)
            begin = len(before) if index is None else index
            span, centre = per_axis_scalars(self, axes, "span", "centre")
            changed = (*before[:begin], *_memory(width, span, centre), *before[begin:])
        return changed if np.any(width) else before


def _memory(width: Array, span: Array, centre: Array) -> tuple[Stage, ...]:
    """Stages for a chain without hysteresis: u + c (mean of H_r[u] - u + 2 mean of r (u - centre)), r in units of the span."""
    threshold = 0.5 * ((np.arange(OPERATORS) + 0.5) / OPERATORS) ** DENSER
    opening = np.mean(np.minimum(2.0 * threshold, 1.0 - 2.0 * threshold))  # of the operators' mean, at the middle of a span of 1
    share, lost = width / opening, 2.0 * np.mean(threshold)  # of the span, where it is driven from end to end
    weights = np.repeat(share[:, None] / OPERATORS, OPERATORS, axis=1)
    return (
        PrandtlIshlinskii(frozen(span[:, None] * threshold), frozen(weights), frozen(1.0 - share * (1.0 - lost))),
        Offset(frozen(-share * lost * centre)),
    )


def _growth(values: Values, around: Surroundings, stages: Sequence[Stage]) -> Values:
    """The growth of the quasi-static loop over the command's range: thresholds beyond half the amplitude narrow it where they grow."""
    if not values.get("scaled"):
        return values
    index = hysteresis_index(stages)
    assert index is not None, "operators that were scaled"
    before = tuple(stages[: index + 1])
    changed = HysteresisWidth(values["width"], scaled=values["scaled"]).applied(before, around.axes)
    usual, new = _loop(before, around), _loop(changed, around)
    return {**values, "width": float(np.mean(new / usual)) - 1.0} if np.all(usual > 0.0) else values


def _loop(stages: Sequence[Stage], around: Surroundings) -> Array:
    """Area (A,) of the second loop over the range of the command, driven slowly."""
    low, high = around.command
    drive = np.interp(np.arange(4 * LEG + 1), LEG * np.arange(5), [low, high, low, high, low])
    running = Chain(tuple(stages)).filter(Sampling(1.0, around.axes, "foh"))
    rows = np.repeat(drive[:, None], around.axes, axis=1)
    running.settle(rows[0])
    made = running.process(rows)[2 * LEG :]
    return np.abs(0.5 * (made[1:] + made[:-1]).T @ np.diff(drive[2 * LEG :]))


EFFECT = Effect(
    "hysteresis_width",
    "hysteresis",
    "The loops are wider or narrower than the model's, about the same mean curve.",
    lambda around: (
        Parameter("width", "", 0.0, (0.02,), -0.6, 0.6, 0.1),
        Parameter("scaled", "", 0.0, (0.0, 1.0, 2.0), 0.0, 2.0, 1.0, told=False),
    ),
    lambda values, around: HysteresisWidth(
        values["width"], max(around.command[1] - around.command[0], 1e-300), sum(around.command) / 2, values.get("scaled", 0.0)
    ),
    variants=lambda around: ({"scaled": 0.0}, {"scaled": 1.0}, {"scaled": 2.0}),
    reported=_growth,
    phrase="a change of the hysteresis width by {width}",
)
