"""The rate part of the hysteresis: scaled, or added where there is none."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hyst_control.chain.linear import RateCorrection
from hyst_control.chain.parameter import Array, ScalarPerAxis, scalar
from hyst_control.chain.stage import Modifier, Stage, frozen, per_axis_scalar, register, replaced
from hyst_control.effects.effect import Effect, Parameter
from hyst_control.effects.modifiers import beside
from hyst_control.errors import InputError

ADDED_SHARE = 0.1
ADDED_TIME = 1e-3
"""Share and lag that `factor` 2 adds to a model without a rate part: a tenth of its output comes late, with 1 ms; 0 takes as much off."""


@register
@dataclass(frozen=True)
class HysteresisRate(Modifier):
    """Scales the rate part of the hysteresis before it by `factor`: m1 and m2, beta, k1 of the lag beside Madelung hysteresis.

    Where there is none it adds one of first order, -(factor - 1) 0.1 slope τ s / (τ s + 1) of the command with τ = 1 ms and the
    model's mean slope: that share of the output comes late, so the loop widens with frequency.
    """

    name: ClassVar[str] = "hysteresis_rate"
    place: ClassVar[str] = "hysteresis"
    factor: ScalarPerAxis = scalar("", "of the rate part", lower=0.0)

    def applied(self, before: tuple[Stage, ...], axes: int) -> tuple[Stage, ...]:
        factor = per_axis_scalar(self.factor, axes, "factor")
        changed = replaced(before, lambda stage: stage.with_rate_part(factor)) or replaced(
            before, lambda stage: _added(stage, factor)
        )
        if changed is None:
            raise InputError("hysteresis_rate: no hysteresis before it whose rate part could change: put it behind one")
        return changed if np.any(factor != 1.0) else before


def _added(stage: Stage, factor: Array) -> Stage | None:
    slope = stage.mean_slope(len(factor))
    if slope is None:
        return None
    return beside(stage, RateCorrection(frozen(-(factor - 1.0) * ADDED_SHARE * slope * ADDED_TIME), ADDED_TIME))


EFFECT = Effect(
    "hysteresis_rate",
    "hysteresis",
    "The hysteresis depends more or less on the command's rate than the model's.",
    lambda around: (Parameter("factor", "", 1.0, (1.05,), 0.0, 4.0, 0.5),),
    lambda values, around: HysteresisRate(values["factor"]),
)
