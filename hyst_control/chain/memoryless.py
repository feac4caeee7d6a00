"""Memoryless stages: gain, offset, saturation, quantisation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from hyst_control.chain.stage import (
    Array,
    Filter,
    Sampling,
    Stage,
    per_axis_scalar,
    register,
    require_finite,
    require_positive,
)
from hyst_control.errors import InputError


class StaticFilter(Filter):
    """A memoryless function applied sample by sample; the hold of the signal passes through."""

    def __init__(self, function: Callable[[Array], Array], hold: str) -> None:
        self.function = function
        self.hold = hold

    def settle(self, value: Array) -> Array:
        return self.function(np.asarray(value, dtype=float))

    def process(self, block: Array) -> Array:
        return self.function(block)


@register
@dataclass(frozen=True)
class Gain(Stage):
    """y = gain · u."""

    name: ClassVar[str] = "gain"
    gain: Any

    def check(self) -> None:
        require_finite(self.gain, "gain")

    def filter(self, sampling: Sampling) -> Filter:
        gain = per_axis_scalar(self.gain, sampling.axes, "gain")
        return StaticFilter(lambda u: u * gain, sampling.hold)


@register
@dataclass(frozen=True)
class Offset(Stage):
    """y = u + offset, in the signal's own unit."""

    name: ClassVar[str] = "offset"
    offset: Any

    def check(self) -> None:
        require_finite(self.offset, "offset")

    def filter(self, sampling: Sampling) -> Filter:
        offset = per_axis_scalar(self.offset, sampling.axes, "offset")
        return StaticFilter(lambda u: u + offset, sampling.hold)


@register
@dataclass(frozen=True)
class Saturation(Stage):
    """y = min(max(u, lower), upper), in the signal's own unit; an infinite limit is none."""

    name: ClassVar[str] = "saturation"
    lower: Any
    upper: Any

    def check(self) -> None:
        for field in ("lower", "upper"):
            require_finite(getattr(self, field), field, infinite_allowed=True)
        axes = max(len(value) if isinstance(value, tuple) else 1 for value in (self.lower, self.upper))
        if np.any(per_axis_scalar(self.lower, axes, "lower") >= per_axis_scalar(self.upper, axes, "upper")):
            raise InputError(f"lower: {self.lower} is not below upper {self.upper}")

    def filter(self, sampling: Sampling) -> Filter:
        lower = per_axis_scalar(self.lower, sampling.axes, "lower")
        upper = per_axis_scalar(self.upper, sampling.axes, "upper")
        return StaticFilter(lambda u: np.minimum(np.maximum(u, lower), upper), sampling.hold)


@register
@dataclass(frozen=True)
class Quantization(Stage):
    """y = step · round(u / step), halves to even: the lattice of a converter. `step` in the signal's own unit; 0: none."""

    name: ClassVar[str] = "quantization"
    step: Any

    def check(self) -> None:
        require_positive(self.step, "step", "(signal unit)", zero_allowed=True)

    def filter(self, sampling: Sampling) -> Filter:
        step = per_axis_scalar(self.step, sampling.axes, "step")
        if np.all(step > 0):
            return StaticFilter(lambda u: step * np.rint(u / step), sampling.hold)
        divisor = np.where(step > 0, step, 1.0)
        return StaticFilter(lambda u: np.where(step > 0, step * np.rint(u / divisor), u), sampling.hold)
