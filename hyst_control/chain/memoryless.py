# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Memoryless stages: gain, offset, saturation, quantization."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, ClassVar

import numpy as np
from numba import njit

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.chain.c_code.c_code import MAXIMUM, MINIMUM, CCode, each_axis
from hyst_control.chain.c_code.texts import c_texts
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.chain.parameter import ScalarPerAxis, Scattering, scalar
from hyst_control.chain.stage import Filter, Sampling, Stage, per_axis_scalar, per_axis_scalars, register

C = c_texts(__file__)


class StaticFilter(Filter):
    """A memoryless function applied sample by sample; the hold of the signal passes through. `code` is the same in C."""

    def __init__(self, function: Callable[[Array], Array], hold: str, code: CCode | None = None) -> None:
        self.function = function
        self.hold = hold
        self.code = code

    def settle(self, value: Array) -> Array:
        return self.function(np.asarray(value, dtype=float))

    def process(self, block: Array) -> Array:
        return self.function(block)

    def c_code(self) -> CCode:
        return super().c_code() if self.code is None else self.code


@dataclass(frozen=True)
class Memoryless(Stage):
    """A function of the input (N, A) or (A,), all axes at once; part of a started chain only, never of a model file."""

    function: Callable[[Array], Array]
    code: CCode | None = field(default=None, compare=False)

    def filter(self, sampling: Sampling) -> Filter:
        return StaticFilter(self.function, sampling.hold, self.code)


@register
@dataclass(frozen=True)
class Gain(Stage):
    """y = gain · u."""

    name: ClassVar[str] = "gain"
    equation: ClassVar[str] = r"y = \mathrm{gain}\, u"
    gain: ScalarPerAxis = scalar("output unit / input unit", "factor")

    def linearized(self, axes: int) -> tuple[Stage, ...]:
        return (TransferFunction([[float(g)] for g in per_axis_scalar(self.gain, axes, "gain")], [1.0]),)

    def filter(self, sampling: Sampling) -> Filter:
        gain = per_axis_scalar(self.gain, sampling.axes, "gain")
        code = each_axis("u * p->gain[i]", "gain", {"gain": (gain, "output unit / input unit")})
        return StaticFilter(lambda u: u * gain, sampling.hold, code)


@register
@dataclass(frozen=True)
class Offset(Stage):
    """y = u + offset, in the signal's own unit."""

    name: ClassVar[str] = "offset"
    equation: ClassVar[str] = r"y = u + \mathrm{offset}"
    offset: ScalarPerAxis = scalar("signal unit", "constant that is added", scatter=Scattering.ABSOLUTE)

    def linearized(self, axes: int) -> tuple[Stage, ...]:
        return ()

    def filter(self, sampling: Sampling) -> Filter:
        offset = per_axis_scalar(self.offset, sampling.axes, "offset")
        code = each_axis("u + p->added[i]", "offset", {"added": (offset, "signal unit")})
        return StaticFilter(lambda u: u + offset, sampling.hold, code)


@njit(cache=True, error_model="numpy")
def rectified(x: float) -> float:
    """log(1 + e^x), which is x far above 0 and 0 far below, by the functions of the C library, which the exported C calls too."""
    if x > 0.0:
        return x + math.log1p(math.exp(-x))
    return math.log1p(math.exp(x))


@njit(cache=True, error_model="numpy")
def gradual_limits(
    signal: Annotated[Array, "N A"], lower: Annotated[Array, "A"], upper: Annotated[Array, "A"], knee: Annotated[Array, "A"]
) -> Annotated[Array, "N A"]:
    """Limit a signal (N, A) as `Saturation` says."""
    output = np.empty_like(signal)
    for row in range(signal.shape[0]):
        for axis in range(signal.shape[1]):
            value, width = signal[row, axis], knee[axis]
            if width > 0.0:
                if np.isfinite(upper[axis]):
                    value = upper[axis] - width * rectified((upper[axis] - value) / width)
                if np.isfinite(lower[axis]):
                    value = lower[axis] + width * rectified((value - lower[axis]) / width)
                output[row, axis] = value
            else:
                output[row, axis] = np.minimum(np.maximum(value, lower[axis]), upper[axis])
    return output


@register
@dataclass(frozen=True)
class Saturation(Stage):
    """y = min(max(u, lower), upper), in the signal's own unit; an infinite limit is none.

    With `knee` a limit is reached gradually: y = upper - knee log(1 + exp((upper - u) / knee)), and alike at `lower`.
    """

    name: ClassVar[str] = "saturation"
    equation: ClassVar[str] = r"y = \min\left(\max\left(u, \mathrm{lower}\right), \mathrm{upper}\right)"
    place: ClassVar[str] = "drive"
    only_limits: ClassVar[bool] = True
    lower: ScalarPerAxis = scalar("signal unit", "least output", infinite=True)
    upper: ScalarPerAxis = scalar("signal unit", "greatest output", infinite=True)
    knee: ScalarPerAxis = scalar("signal unit", "width over which a limit sets in; 0: at once", default=0.0, lower=0.0)

    def check(self) -> None:
        axes = max(len(value) if isinstance(value, tuple) else 1 for value in (self.lower, self.upper))
        if np.any(per_axis_scalar(self.lower, axes, "lower") >= per_axis_scalar(self.upper, axes, "upper")):
            raise InputError(f"lower: {self.lower} is not below upper {self.upper}")

    def filter(self, sampling: Sampling) -> Filter:
        lower, upper, knee = per_axis_scalars(self, sampling.axes, "lower", "upper", "knee")
        limits = {"lower": (lower, "signal unit, least output"), "upper": (upper, "signal unit, greatest output")}
        if knee.any():
            code = each_axis(
                "gradual_limit(u, p->lower[i], p->upper[i], p->knee[i])",
                "knee",
                {**limits, "knee": (knee, "signal unit, width of a limit; 0: at once")},
                (MAXIMUM, MINIMUM, C["KNEE"]),
            )
            return StaticFilter(
                lambda u: gradual_limits(np.atleast_2d(u), lower, upper, knee).reshape(u.shape), sampling.hold, code
            )
        code = each_axis("minimum_of(maximum_of(u, p->lower[i]), p->upper[i])", "limits", limits, (MAXIMUM, MINIMUM))
        return StaticFilter(lambda u: np.minimum(np.maximum(u, lower), upper), sampling.hold, code)


@register
@dataclass(frozen=True)
class Quantization(Stage):
    """y = step · round(u / step), halves to even: the value grid of a converter. `step` in the signal's own unit; 0: none."""

    name: ClassVar[str] = "quantization"
    equation: ClassVar[str] = r"y = \mathrm{step} \cdot \mathrm{round}\left(\frac{u}{\mathrm{step}}\right)"
    place: ClassVar[str] = "adc"
    only_limits: ClassVar[bool] = True
    step: ScalarPerAxis = scalar("signal unit", "distance of two values; 0: none", lower=0.0)

    def filter(self, sampling: Sampling) -> Filter:
        step = per_axis_scalar(self.step, sampling.axes, "step")
        rounded = "(p->step[i] > R(0.0)) ? (p->step[i] * M(rint)(u / p->step[i])) : u"
        code = each_axis(rounded, "lattice", {"step": (step, "signal unit, distance of two values; 0: none")})
        divisor = np.where(step > 0, step, 1.0)
        return StaticFilter(lambda u: np.where(step > 0, step * np.rint(u / divisor), u), sampling.hold, code)
