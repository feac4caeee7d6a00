"""The width of the hysteresis: its memory part scaled, its single-valued mean curve kept."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from hyst_control.chain.chain import Parallel
from hyst_control.chain.madelung import Madelung, end_slope
from hyst_control.chain.memoryless import Gain, Offset
from hyst_control.chain.prandtl_ishlinskii import ModifiedPrandtlIshlinskii, PlayOperator, PrandtlIshlinskii
from hyst_control.chain.rate_dependent_prandtl_ishlinskii import RateDependentPrandtlIshlinskii
from hyst_control.chain.stage import (
    Array,
    Modifier,
    Stage,
    frozen,
    per_axis,
    per_axis_scalar,
    register,
    require_finite,
    require_positive,
)
from hyst_control.effects.effect import Effect, Parameter
from hyst_control.effects.modifiers import Memoryless, numbers, replaced, scaled
from hyst_control.effects.placement import hysteresis_index
from hyst_control.errors import InputError

OPERATORS, DENSER = 8, 1.5  # the exponent: a measured stack's nested loops, see docs/diagnosis.md


@register
@dataclass(frozen=True)
class HysteresisWidth(Modifier):
    """Scales the memory of the hysteresis before it by 1 + width; its mean curve stays.

    The mean curve of a play operator H[u] is u, also under the dynamic weights of the modified Prandtl-Ishlinskii model; that of
    Madelung hysteresis is the mean of the two major branches.

    A chain without hysteresis gets one behind what is before: u + c (mean of H_r[u] - u + 2 mean of r (u - centre) / span) over the
    play operators of `OPERATORS` thresholds r up to half of `span` (V), denser toward 0, with c such that a drive over the span, up
    and down about `centre` (V), gives a loop that opens by width span at its middle. Its ends stay where they were: they are what a
    model without hysteresis was fitted to.
    """

    name: ClassVar[str] = "hysteresis_width"
    width: Any
    span: Any = 100.0
    centre: Any = 0.0

    def check(self) -> None:
        require_finite(self.width, "width")
        require_positive(self.span, "span", "V")
        require_finite(self.centre, "centre")

    def applied(self, before: tuple[Stage, ...], axes: int) -> tuple[Stage, ...]:
        width = per_axis_scalar(self.width, axes, "width")
        changed = replaced(before, lambda stage: _widened(stage, width))
        if changed is None and hysteresis_index(before) is None:
            span, centre = (per_axis_scalar(getattr(self, name), axes, name) for name in ("span", "centre"))
            changed = (*before, *_memory(width, span, centre))
        if changed is None:
            raise InputError("hysteresis_width: no hysteresis before it whose width could change: put it behind one")
        return changed if np.any(width) else before


def _memory(width: Array, span: Array, centre: Array) -> tuple[Stage, ...]:
    """What a chain without hysteresis gets: u + c (mean of H_r[u] - u + 2 mean of r (u - centre)), r in units of the span."""
    threshold = 0.5 * ((np.arange(OPERATORS) + 0.5) / OPERATORS) ** DENSER
    opening = np.mean(np.minimum(2.0 * threshold, 1.0 - 2.0 * threshold))  # of the operators' mean, at the middle of a span of 1
    share, lost = width / opening, 2.0 * np.mean(threshold)  # of the span, where it is driven from end to end
    weights = np.repeat(share[:, None] / OPERATORS, OPERATORS, axis=1)
    return (
        PrandtlIshlinskii(frozen(span[:, None] * threshold), frozen(weights), frozen(1.0 - share * (1.0 - lost))),
        Offset(frozen(-share * lost * centre)),
    )


def _widened(stage: Stage, width: Array) -> Stage | None:
    axes = len(width)
    if isinstance(stage, PlayOperator):
        thresholds = [[r] for r in per_axis_scalar(stage.threshold, axes, "threshold")]
        return PrandtlIshlinskii(thresholds, (1.0 + width)[:, None], frozen(-width), stage.one_sided)
    if isinstance(stage, (PrandtlIshlinskii, RateDependentPrandtlIshlinskii)):
        slope = np.array([weights.sum() for weights in per_axis(stage.weights, axes, 1, "weights")])
        (w0,) = numbers(stage, axes, "w0")
        return replace(stage, weights=scaled(stage.weights, 1.0 + width, 1, "weights"), w0=frozen(w0 - width * slope))
    if isinstance(stage, ModifiedPrandtlIshlinskii):
        return Parallel(((_with_share(stage, 1.0 + width),), (_with_share(_mean(stage, axes), -width),)))
    if isinstance(stage, Madelung) and not stage.inverse:
        return Parallel(((stage, Gain(frozen(1.0 + width))), (Memoryless(mean_curve(stage, axes)), Gain(frozen(-width)))))
    return None


def _with_share(stage: ModifiedPrandtlIshlinskii, share: Array) -> ModifiedPrandtlIshlinskii:
    """The model's output times a share (A,)."""
    rest = {name: scaled(getattr(stage, name), share, 0, name) for name in ("m1", "m2", "k", "b", "w0")}
    return replace(stage, weights=scaled(stage.weights, share, 1, "weights"), **rest)


def _mean(stage: ModifiedPrandtlIshlinskii, axes: int) -> ModifiedPrandtlIshlinskii:
    """The model with u in place of every H_i[u]: one operator of threshold 0, with the sum of the weights."""
    weights = per_axis(stage.weights, axes, 1, "weights")
    count = np.array([float(len(item)) for item in weights])
    rest = {name: scaled(getattr(stage, name), count, 0, name) for name in ("m1", "m2", "k", "b")}
    return replace(stage, thresholds=(0.0,), weights=[[item.sum()] for item in weights], **rest)


def mean_curve(stage: Madelung, axes: int) -> Callable[[Array], Array]:
    """Mean of the major branches, straight beyond the loop's ends as Madelung hysteresis is; volts to the stage's output."""
    curves = stage.curves(axes)
    span, scale = numbers(stage, axes, "input_scale", "output_scale")

    def mean(u: Array) -> Array:
        output = np.empty_like(u)
        for axis, (up, down) in enumerate(curves):
            x = u[..., axis] / span[axis]
            inside = np.clip(x, 0.0, 1.0)
            beyond = np.where(x > 1.0, end_slope(up, 1.0), end_slope(down, 0.0)) * (x - inside)
            output[..., axis] = scale[axis] * (0.5 * (up(inside) + down(inside)) + beyond)
        return output

    return mean


EFFECT = Effect(
    "hysteresis_width",
    "hysteresis",
    "The loops are wider or narrower than the model's, about the same mean curve.",
    lambda around: (Parameter("width", "", 0.0, (0.02,), -0.6, 0.6, 0.1),),
    lambda values, around: HysteresisWidth(
        values["width"], max(around.command[1] - around.command[0], 1e-300), sum(around.command) / 2
    ),
)
