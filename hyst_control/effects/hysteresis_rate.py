"""The rate part of the hysteresis: scaled, or added where there is none."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from hyst_control.chain.linear import RateCorrection
from hyst_control.chain.madelung import Madelung
from hyst_control.chain.prandtl_ishlinskii import ModifiedPrandtlIshlinskii, PlayOperator, PrandtlIshlinskii
from hyst_control.chain.rate_dependent_prandtl_ishlinskii import RateDependentPrandtlIshlinskii
from hyst_control.chain.stage import Array, Modifier, Stage, frozen, per_axis, per_axis_scalar, register, require_positive
from hyst_control.effects.effect import Effect, Parameter
from hyst_control.effects.modifiers import beside, numbers, replaced, scaled
from hyst_control.errors import InputError

RATE_PARTS = {ModifiedPrandtlIshlinskii: ("m1", "m2"), RateDependentPrandtlIshlinskii: ("beta",), RateCorrection: ("k1",)}
"""Parameters that make a model rate-dependent."""

ADDED_SHARE = 0.1
ADDED_TIME = 1e-3
"""What `factor` 2 adds to a model without a rate part: a tenth of its output comes late, with 1 ms; 0 takes as much off."""


@register
@dataclass(frozen=True)
class HysteresisRate(Modifier):
    """Scales the rate part of the hysteresis before it by `factor`: m1 and m2, beta, k1 of the lag beside Madelung hysteresis.

    Where there is none it adds one of first order, -(factor - 1) 0.1 slope τ s / (τ s + 1) of the command with τ = 1 ms and the
    model's mean slope: that share of the output comes late, so the loop widens with frequency.
    """

    name: ClassVar[str] = "hysteresis_rate"
    factor: Any

    def check(self) -> None:
        require_positive(self.factor, "factor", "", zero_allowed=True)

    def applied(self, before: tuple[Stage, ...], axes: int) -> tuple[Stage, ...]:
        factor = per_axis_scalar(self.factor, axes, "factor")
        changed = replaced(before, lambda stage: _scaled(stage, factor)) or replaced(before, lambda stage: _added(stage, factor))
        if changed is None:
            raise InputError("hysteresis_rate: no hysteresis before it whose rate part could change: put it behind one")
        return changed if np.any(factor != 1.0) else before


def _scaled(stage: Stage, factor: Array) -> Stage | None:
    names = RATE_PARTS.get(type(stage), ())
    if not any(np.any(values) for values in numbers(stage, len(factor), *names)):
        return None
    return replace(stage, **{name: scaled(getattr(stage, name), factor, 0, name) for name in names})


def _added(stage: Stage, factor: Array) -> Stage | None:
    axes = len(factor)
    if isinstance(stage, PlayOperator):
        slope = np.ones(axes)
    elif isinstance(stage, (PrandtlIshlinskii, ModifiedPrandtlIshlinskii, RateDependentPrandtlIshlinskii)):
        slope = np.array([weights.sum() for weights in per_axis(stage.weights, axes, 1, "weights")]) + numbers(stage, axes, "w0")[0]
    elif isinstance(stage, Madelung) and not stage.inverse:
        span, scale = numbers(stage, axes, "input_scale", "output_scale")
        slope = np.array([float(up(np.ones(1))[0]) for up, _ in stage.curves(axes)]) * scale / span
    else:
        return None
    return beside(stage, RateCorrection(frozen(-(factor - 1.0) * ADDED_SHARE * slope * ADDED_TIME), ADDED_TIME))


EFFECT = Effect(
    "hysteresis_rate",
    "hysteresis",
    "The hysteresis depends more or less on the command's rate than the model's.",
    lambda around: (Parameter("factor", "", 1.0, (1.05,), 0.0, 4.0, 0.5),),
    lambda values, around: HysteresisRate(values["factor"]),
)
