# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The rate part of the hysteresis: scaled, or added where there is none."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.chain.chain import Parallel
from hyst_control.chain.linear.linear_stages import RateCorrection
from hyst_control.chain.parameter import ScalarPerAxis, scalar
from hyst_control.chain.stage import Modifier, Stage, frozen, per_axis_scalar, per_axis_scalars, register, replaced
from hyst_control.effects.effect import Effect, Parameter, Surroundings

ADDED_SHARE = 0.1
ADDED_TIME = 1e-3
"""Share and lag that `factor` 2 adds to a model without a rate part: a tenth of its output comes late, with 1 ms; 0 takes as much off."""


@register
@dataclass(frozen=True)
class HysteresisRate(Modifier):
    """Scales the rate part of the hysteresis before it by `factor`: m1 and m2, beta, k1 of the lag beside Madelung hysteresis.

    Where the part is one of rising and one of falling commands, as m1 and m2 are, 1 + (factor - 1)(1 + asymmetry) is the first
    one's factor and 1 + (factor - 1)(1 - asymmetry) the other's.

    Where there is none, or with `lag` (s), it adds one of first order, -(factor - 1) 0.1 slope τ s / (τ s + 1) of the command with
    τ = `lag`, or 1 ms, and the model's mean slope: that share of the output comes late, so the loop widens with frequency.
    """

    name: ClassVar[str] = "hysteresis_rate"
    place: ClassVar[str] = "hysteresis"
    factor: ScalarPerAxis = scalar("", "of the rate part", lower=0.0)
    asymmetry: ScalarPerAxis = scalar("", "part of the change that only rising commands have", default=0.0, lower=-1.0, upper=1.0)
    lag: ScalarPerAxis = scalar("s", "of a part that is added; 0: what there is is scaled", default=0.0, lower=0.0)

    def applied(self, before: tuple[Stage, ...], axes: int) -> tuple[Stage, ...]:
        factor = per_axis_scalar(self.factor, axes, "factor")
        asymmetry, lag = per_axis_scalars(self, axes, "asymmetry", "lag")
        rising, falling = (np.maximum(1.0 + (factor - 1.0) * (1.0 + sign * asymmetry), 0.0) for sign in (1.0, -1.0))
        own = lag == 0.0
        changed = replaced(before, lambda stage: stage.with_rate_parts(np.where(own, rising, 1.0), np.where(own, falling, 1.0)))
        if changed is not None and not own.all():
            changed = replaced(changed, lambda stage: _added(stage, np.where(own, 1.0, factor), np.where(own, ADDED_TIME, lag)))
        elif changed is None:
            changed = replaced(before, lambda stage: _added(stage, factor, np.where(own, ADDED_TIME, lag)))
        if changed is None:
            raise InputError("hysteresis_rate: no hysteresis before it whose rate part could change: put it behind one")
        return changed if np.any(factor != 1.0) else before


def _added(stage: Stage, factor: Array, lag: Array) -> Stage | None:
    slope = stage.mean_slope(len(factor))
    if slope is None:
        return None
    return Parallel(((stage,), (RateCorrection(frozen(-(factor - 1.0) * ADDED_SHARE * slope * lag), frozen(lag)),)))


def parameters(around: Surroundings) -> tuple[Parameter, ...]:
    """Factor, its difference between rising and falling commands, and the time constant of a part that is added."""
    ts = around.sample_time
    return (
        Parameter("factor", "", 1.0, (1.05,), 0.0, 4.0, 0.5),
        Parameter("asymmetry", "", 0.0, (0.0,), -1.0, 1.0, 0.5, told=False),
        Parameter("lag", "s", 0.0, (max(ADDED_TIME, 2.0 * ts),), ts, 0.1 * around.duration, 1.5, True, told=False),
    )


EFFECT = Effect(
    "hysteresis_rate",
    "hysteresis",
    "The hysteresis depends more or less on the command's rate than the model's.",
    parameters,
    lambda values, around: HysteresisRate(values["factor"], values.get("asymmetry", 0.0), values.get("lag", 0.0)),
    variants=lambda around: ({"lag": 0.0}, {"asymmetry": 0.0}),
    phrase="a rate part of the hysteresis that is {factor} of the model's",
)
