# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Hysteresis by Madelung's rules: a stack of turning points, and a branch from the last one back towards the one before.

Rules: (1) a curve that leaves a turning point is fixed by it; (2) if it reverses, the new curve returns to that point;
(3) past it, it continues the curve that led there, and the inner loop is wiped out. The major ascending and descending
curves f0, g0 (MHL paper Eq. 1, 2) are moved to the turning point and scaled in y so that the branch closes:

    ascending from (a, y_a) towards (b, y_b):   y = y_a + (y_b - y_a) φ_up(u - a) / φ_up(b - a),   φ_up(d) = f0(d)
    descending from (b, y_b) towards (a, y_a):  y = y_b - (y_b - y_a) φ_dn(b - u) / φ_dn(b - a),   φ_dn(d) = F - g0(1 - d)

with F = f0(1) = g0(1). Inputs are normalized to 0…1, from `input_offset` to `input_offset + input_scale`; beyond the ends of the
major loop the curve continues straight, with its slope there, and remembers nothing. Where the loop begins at 0 V or above, the
first curve from rest is the ascending one, and where it ends at 0 V or below the descending one. Where 0 V lies inside the loop,
rest at 0 V is what a drive that has died away leaves: turning points alternately above and below, ever closer to 0 V.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numba import njit

from hyst_control.base.arrays import Array, Integers
from hyst_control.base.errors import InputError
from hyst_control.chain.bounded_cache import remembered
from hyst_control.chain.c_code.c_code import MAXIMUM, MINIMUM, CCode, integers, reals
from hyst_control.chain.c_code.texts import c_filled, c_texts
from hyst_control.chain.chain import Parallel
from hyst_control.chain.hysteresis.curves import EVALUATE, SOLVE, Curve, evaluate_curve, knot_curve, polynomial_curve, solve_curve
from hyst_control.chain.memoryless import Gain, Memoryless
from hyst_control.chain.parameter import AllAxes, ScalarPerAxis, Scattering, VectorPerAxis, all_axes, flag, scalar, vector
from hyst_control.chain.stage import (
    Filter,
    Role,
    Sampling,
    Stage,
    depth,
    frozen,
    per_axis,
    per_axis_scalars,
    register,
)

C = c_texts(__file__)
CAPACITY = 48
"""Turning points that the C of an axis keeps beside those of rest, which are constants. Up to there it is the Python filter to the last
bit; where more are nested, it forgets the loop whose end comes closest to its begin, and counts that in `forgotten`: then the loops
outside the forgotten one are still exact, and those inside it close where it would have. The Python filter keeps all."""


Curves = tuple[Array, Array, Array, Array, float, Array]
"""Breaks and coefficients of the rising and of the falling curve of an axis, the output at the end, slopes beyond the ends."""
Memory = tuple[Array, Integers, Array]
"""Turning points (u, y) of an axis (capacity, 2), how many there are (1,), and where it is (3,): u, y and direction; updated."""
Scales = tuple[float, float, float]  # Offset of the input in V, and the factors into and out of normalized numbers
NORMALIZED: Scales = (0.0, 1.0, 1.0)


@njit(cache=True, error_model="numpy")
def madelung_branches(source: Array, inverse: bool, curves: Curves, memory: Memory, output: Array, start: int) -> int:
    """Follow one axis from row `start`; returns the row reached, less than N only when the stack is full.

    source (N,), output (N,) normalized: input → output, or output → input with `inverse`.
    """
    rising_breaks, rising, falling_breaks, falling, full, end_slope = curves
    stack, stack_depth, last = memory
    depth_now = stack_depth[0]
    key = 1 if inverse else 0
    top_of_range = full if inverse else 1.0
    u, y, direction = last[0], last[1], last[2]
    u_from, y_from, stretch, whole = 0.0, 0.0, 0.0, 0.0
    moved_to_branch = True
    for row in range(start, source.size):
        raw = source[row]
        x = 0.0 if raw < 0.0 else (top_of_range if raw > top_of_range else raw)
        before = y if inverse else u
        if x != before and x == x:  # NaN comes out again and leaves no turning point
            onward = 1.0 if x > before else -1.0
            if onward != direction:
                if stack[depth_now - 1, key] != before:
                    if depth_now == stack.shape[0]:
                        stack_depth[0] = depth_now
                        last[0], last[1], last[2] = u, y, direction
                        return row
                    stack[depth_now, 0], stack[depth_now, 1] = u, y
                    depth_now += 1
                direction = onward
                moved_to_branch = True
            if x >= top_of_range or x <= 0.0:
                u, y = (1.0, full) if x > 0.0 else (0.0, 0.0)
                stack[0, 0], stack[0, 1] = 1.0 - u, full - y
                stack[1, 0], stack[1, 1] = u, y
                depth_now = 2
                moved_to_branch = True
            else:
                while depth_now > 2 and direction * (x - stack[depth_now - 2, key]) >= 0.0:
                    depth_now -= 2
                    moved_to_branch = True
                if moved_to_branch:
                    u_from, y_from = stack[depth_now - 1, 0], stack[depth_now - 1, 1]
                    u_to, y_to = stack[depth_now - 2, 0], stack[depth_now - 2, 1]
                    if direction > 0.0:
                        whole = evaluate_curve(u_to - u_from, rising_breaks, rising)
                    else:
                        whole = evaluate_curve(u_from - u_to, falling_breaks, falling)
                    stretch = (y_to - y_from) / whole
                    moved_to_branch = False
                if inverse:
                    if direction > 0.0:
                        u = u_from + solve_curve((x - y_from) / stretch, rising_breaks, rising)
                    else:
                        u = u_from - solve_curve((x - y_from) / stretch, falling_breaks, falling)
                    y = x
                else:
                    if direction > 0.0:
                        y = y_from + stretch * evaluate_curve(x - u_from, rising_breaks, rising)
                    else:
                        y = y_from + stretch * evaluate_curve(u_from - x, falling_breaks, falling)
                    u = x
        value = u if inverse else y
        if raw != x:
            slope = end_slope[1] if raw > x else end_slope[0]
            value += (raw - x) / slope if inverse else (raw - x) * slope
        output[row] = value
    stack_depth[0] = depth_now
    last[0], last[1], last[2] = u, y, direction
    return source.size


@njit(cache=True, error_model="numpy")
def scaled_branches(
    block: Array, axis: int, scales: Scales, inverse: bool, curves: Curves, memory: Memory, output: Array, start: int
) -> int:
    """`madelung_branches` of an `axis` in units: one call in place of an array operation for each scale, which a single row pays for."""
    count, (offset, to_inside, to_outside) = block.shape[0], scales
    source, result = np.empty(count), np.empty(count)
    for row in range(start, count):
        source[row] = (block[row, axis] if inverse else block[row, axis] - offset) * to_inside
    reached = madelung_branches(source, inverse, curves, memory, result, start)
    for row in range(start, reached):
        scaled = result[row] * to_outside
        output[row, axis] = scaled + offset if inverse else scaled
    return reached


class MadelungFilter(Filter):
    """Streaming Madelung hysteresis, or its inverse, one stack per axis."""

    def __init__(self, stage: Madelung, sampling: Sampling) -> None:
        curves, names = stage.curves(sampling.axes), ("input_offset", "input_scale", "output_scale")
        input_offset, input_scale, output_scale = per_axis_scalars(stage, sampling.axes, *names)
        self.hold, self.inverse = sampling.hold, stage.inverse
        self.input_offset = input_offset
        self.rest = -input_offset / input_scale  # of 0 V, normalized
        self.to_inside = 1.0 / (output_scale if self.inverse else input_scale)
        self.to_outside = input_scale if self.inverse else output_scale
        self.rising = [(up.breaks, up.coefficients) for up, _ in curves]
        falling = [mirrored(down) for _, down in curves]
        self.falling = [(curve.breaks, curve.coefficients) for curve in falling]
        self.full = [full_output(up) for up, _ in curves]
        # Beyond the ends: the ascending curve's slope above 1, the descending curve's slope below 0.
        self.end_slope = [np.array([end_slope(down, 0.0), end_slope(up, 1.0)]) for up, down in curves]
        self._scales: list[Scales] = list(
            zip(input_offset.tolist(), self.to_inside.tolist(), self.to_outside.tolist(), strict=True)
        )
        self._curves: list[Curves] = [
            (*rising, *falling, full, slope)
            for rising, falling, full, slope in zip(self.rising, self.falling, self.full, self.end_slope, strict=True)
        ]
        self.stack = [np.zeros((64, 2)) for _ in curves]
        self.stack_depth = [np.zeros(1, dtype=np.int64) for _ in curves]
        self.last = [np.zeros(3) for _ in curves]

    def settle(self, value: Array) -> Array:
        self.rest_at_0_volt()
        return np.asarray(self.process(np.array(value, dtype=float).reshape(1, -1))[0])

    def rest_at_0_volt(self) -> None:
        """Forget all but what the rest at 0 V leaves."""
        for axis, full in enumerate(self.full):
            at_top = self.rest[axis] >= 1.0
            self.stack[axis][:2] = ((0.0, 0.0), (1.0, full)) if at_top else ((1.0, full), (0.0, 0.0))
            self.stack_depth[axis][0] = 2
            self.last[axis][:] = (1.0, full, -1.0) if at_top else (0.0, 0.0, 1.0)
            if 0.0 < self.rest[axis] < 1.0:
                swings = np.repeat(died_away(float(self.rest[axis]))[:, None], len(self.full), axis=1)
                self._follow(axis, swings, np.empty_like(swings), False, NORMALIZED)

    def process(self, block: Array) -> Array:
        block = np.ascontiguousarray(block, dtype=float)
        output = np.empty_like(block)
        for axis in range(block.shape[1]):
            self._follow(axis, block, output, self.inverse, self._scales[axis])
        return output

    def c_code(self) -> CCode:
        axes, rested = len(self.full), copy(self)
        rested.stack = [np.zeros_like(stack) for stack in self.stack]
        rested.stack_depth, rested.last = [depth.copy() for depth in self.stack_depth], [last.copy() for last in self.last]
        rested.rest_at_0_volt()
        begin = np.zeros((axes, max(int(count[0]) for count in rested.stack_depth), 2))
        for axis, (stack, count) in enumerate(zip(rested.stack, rested.stack_depth, strict=True)):
            begin[axis, : count[0]] = stack[: count[0]]
        rising, rising_breaks, rising_size = _padded(self.rising)
        falling, falling_breaks, falling_size = _padded(self.falling)
        return CCode(
            "madelung",
            c_filled(C["STEP"], {"FOLLOW": C["BACKWARD" if self.inverse else "FORWARD"]}),
            C["SETTLE"],
            {"CAPACITY": CAPACITY, "INVERSE": int(self.inverse), "KEY": int(self.inverse)},
            {
                "rising_breaks": reals(rising_breaks, "normalized input"),
                "rising": reals(rising, "[axis][1][piece, power], normalized"),
                "rising_size": integers(rising_size, "pieces, order"),
                "falling_breaks": reals(falling_breaks, "normalized input"),
                "falling": reals(falling, "[axis][1][piece, power], normalized"),
                "falling_size": integers(falling_size, "pieces, order"),
                "full": reals(self.full, "normalized output at the end of the input"),
                "end_slope": reals(self.end_slope, "below 0 and above the end of the input"),
                "offset": reals(self.input_offset, "V, lower end of the curves"),
                "rest_stack": reals(begin, "turning points at rest, normalized input and output"),
                "rest_depth": integers(np.concatenate(rested.stack_depth), "turning points at rest"),
                "rest_last": reals(np.array(rested.last), "normalized input, output, and direction at rest"),
                "to_inside": reals(self.to_inside, "1 / input unit"),
                "to_outside": reals(self.to_outside, "output unit"),
            },
            {
                "stack": reals(np.zeros((axes, CAPACITY, 2)), "turning points since rest, normalized input and output"),
                "last": reals(np.zeros((axes, 3)), "normalized input, output, and direction"),
                "branch": reals(np.zeros((axes, 3)), "where it began, and its stretch"),
                "depth": integers(np.zeros(axes), "turning points, those of rest counted"),
                "kept": integers(np.zeros(axes), "of them, those that are still the ones of rest"),
                "moved": integers(np.zeros(axes), "1 where another branch is entered"),
                "forgotten": integers(np.zeros(axes), "loops that found no room"),
            },
            (C["FORGET"], EVALUATE, SOLVE) if self.inverse else (C["FORGET"], EVALUATE),
        )

    def _follow(self, axis: int, block: Array, output: Array, inverse: bool, scales: Scales) -> None:
        """Write the output (N, A) of one axis for a `block` (N, A)."""
        curves, row = self._curves[axis], 0
        while True:
            memory = (self.stack[axis], self.stack_depth[axis], self.last[axis])
            row = scaled_branches(block, axis, scales, inverse, curves, memory, output, row)
            if row == len(block):
                return
            self.stack[axis] = np.concatenate([self.stack[axis], np.zeros_like(self.stack[axis])])


SWINGS = 24  # Swings of the drive that dies away to 0 V


def died_away(rest: float) -> Array:
    """Normalized input (M,) that swings about `rest`, from the whole major loop down to nothing."""
    amplitude = np.linspace(1.0, 0.0, SWINGS + 1)
    swings = np.stack([rest + (1.0 - rest) * amplitude, rest - rest * (amplitude - 0.5 / SWINGS).clip(0.0)], axis=1)
    return np.append(swings.ravel(), rest)


def _padded(curves: list[tuple[Array, Array]]) -> tuple[Array, Array, Integers]:
    """Coefficients (A, 1, K), breaks (A, B) and sizes (A, 2) of curves, one (breaks, coefficients) per axis."""
    sizes = np.array([coefficients.shape for _, coefficients in curves])
    flat = np.zeros((len(curves), 1, max(coefficients.size for _, coefficients in curves)))
    breaks = np.ones((len(curves), sizes[:, 0].max() + 1))
    for axis, (edges, coefficients) in enumerate(curves):
        flat[axis, 0, : coefficients.size] = coefficients.ravel()
        breaks[axis, : len(edges)] = edges
    return flat, breaks, sizes


@remembered
def full_output(curve: Curve) -> float:
    """Value of a curve at the end of the normalized input."""
    return float(curve(np.ones(1))[0])


@remembered
def mirrored(down: Curve) -> Curve:
    """φ_dn(d) = F - g0(1 - d) of a descending curve g0 (`down`) as a curve of its own."""
    count, order = down.coefficients.shape
    full = full_output(down)
    coefficients = np.empty((count, order))
    for piece in range(count):
        # A piece of g0 in the distance from its right end, by repeated synthetic division, with the sign of odd powers changed.
        width = down.breaks[piece + 1] - down.breaks[piece]
        shifted = down.coefficients[piece].copy()
        for end in range(order, 1, -1):
            for i in range(1, end):
                shifted[i] += width * shifted[i - 1]
        coefficients[count - 1 - piece] = -shifted * (-1.0) ** np.arange(order - 1, -1, -1)
    coefficients[:, -1] += full
    coefficients[0, -1] = 0.0
    return Curve(np.ascontiguousarray(1.0 - down.breaks[::-1]), coefficients)


@remembered
def end_slope(curve: Curve, x: float) -> float:
    """Slope dy/du of a curve at its end x = 0 or 1; never less than a thousandth of the mean slope, so that an inverse exists."""
    piece = 0 if x == 0.0 else len(curve.breaks) - 2
    slope = np.polyval(np.polyder(curve.coefficients[piece]), x - curve.breaks[piece])
    return max(float(slope), 1e-3 * full_output(curve))


@register
@dataclass(frozen=True)
class Madelung(Stage):
    """Rate-independent hysteresis from the two curves of the major loop (MHL paper §2.1), where ascending(1) = descending(1).

    A branch from the turning point a back towards b is the curve, moved to a and scaled to end at b.
    """

    name: ClassVar[str] = "madelung"
    equation: ClassVar[str] = (
        r"y = y_a + (y_b - y_a) \frac{\varphi_{\pm}(|u - a|)}{\varphi_{\pm}(|b - a|)} "
        r"\text{ from turning point } a \text{ towards } b, \quad \varphi_{+}(d) = \mathrm{ascending}(d), "
        r"\quad \varphi_{-}(d) = \mathrm{descending}(1) - "
        r"\mathrm{descending}(1 - d)"
    )
    ROLES: ClassVar[Role] = Role.HYSTERESIS | Role.HAS_COMPENSATOR
    ascending: VectorPerAxis = vector("", "polynomial p_n … p_1 of the ascending branch, or its values at the knots")
    descending: VectorPerAxis = vector("", "the descending branch likewise")
    input_scale: ScalarPerAxis = scalar("V", "length of the major loop: its upper end, where `input_offset` is 0", above=0.0)
    output_scale: ScalarPerAxis = scalar("measurement unit", "of a branch's value 1", above=0.0)
    knots: AllAxes | None = all_axes("", "inputs of the branches' values, from 0 to 1", 1, default=None, scatter=Scattering.NONE)
    inverse: bool = flag("whether the stage runs from output to input")
    input_offset: ScalarPerAxis = scalar(
        "V", "lower end of the major loop, below 0 for a bipolar drive", default=0.0, scatter=Scattering.NONE
    )

    def check(self) -> None:
        axes = max(len(value) if depth(value) == 2 else 1 for value in (self.ascending, self.descending))
        self.curves(axes)

    def curves(self, axes: int) -> list[tuple[Curve, Curve]]:
        """Ascending and descending curve of every one of `axes` axes, checked for monotony and closure."""
        pairs = []
        for up, down in zip(
            per_axis(self.ascending, axes, 1, "ascending"), per_axis(self.descending, axes, 1, "descending"), strict=True
        ):
            if self.knots is None:
                pair = polynomial_curve(up, "ascending"), polynomial_curve(down, "descending")
            else:
                knots = np.array(self.knots, dtype=float)
                pair = knot_curve(knots, up, "ascending"), knot_curve(knots, down, "descending")
            ends = [full_output(curve) for curve in pair]
            if abs(ends[0] - ends[1]) > 1e-6 * abs(ends[0]):
                raise InputError(
                    f"descending: ends at {ends[1]:.6g} where ascending ends at {ends[0]:.6g}: scale the curves to meet"
                )
            pairs.append(pair)
        return pairs

    def with_values(self, values: Mapping[str, Any]) -> Madelung:
        """The two major branches end at one point: each is scaled to the mean of their ends."""
        if self.knots is not None:
            return replace(self, **values)
        up, down = (np.array(values.get(name, getattr(self, name)), dtype=float) for name in ("ascending", "descending"))
        ends = up.sum(axis=-1, keepdims=True), down.sum(axis=-1, keepdims=True)
        mean = 0.5 * (ends[0] + ends[1])
        return replace(self, **{**values, "ascending": up * mean / ends[0], "descending": down * mean / ends[1]})

    def mean_slope(self, axes: int) -> Array | None:
        return None if self.inverse else self.slope_of_curves(axes)

    def slope_of_curves(self, axes: int) -> Array:
        """Value at the end of the curves over their length (A,) on so many `axes`, measurement unit per V."""
        span, scale = per_axis_scalars(self, axes, "input_scale", "output_scale")
        return np.array([full_output(up) for up, _ in self.curves(axes)]) * scale / span

    def with_loop_width(self, width: Array) -> Parallel | None:
        """The mean of the major branches takes the mean curve off."""
        if self.inverse:
            return None
        mean = Memoryless(self.mean_curve(len(width)), self._mean_curve_in_c(len(width)))
        return Parallel(((self, Gain(frozen(1.0 + width))), (mean, Gain(frozen(-width)))))

    def mean_curve(self, axes: int) -> Callable[[Array], Array]:
        """Mean of the major branches of `axes` axes, straight beyond the loop's ends as the hysteresis is; V to the stage's output."""
        curves = self.curves(axes)
        lower, span, scale = per_axis_scalars(self, axes, "input_offset", "input_scale", "output_scale")

        def mean(u: Array) -> Array:
            output = np.empty_like(u)
            for axis, (up, down) in enumerate(curves):
                x = (u[..., axis] - lower[axis]) / span[axis]
                inside = np.clip(x, 0.0, 1.0)
                beyond = np.where(x > 1.0, end_slope(up, 1.0), end_slope(down, 0.0)) * (x - inside)
                output[..., axis] = scale[axis] * (0.5 * (up(inside) + down(inside)) + beyond)
            return output

        return mean

    def _mean_curve_in_c(self, axes: int) -> CCode:
        curves = self.curves(axes)
        lower, span, scale = per_axis_scalars(self, axes, "input_offset", "input_scale", "output_scale")
        up, up_breaks, up_size = _padded([(up.breaks, up.coefficients) for up, _ in curves])
        down, down_breaks, down_size = _padded([(down.breaks, down.coefficients) for _, down in curves])
        slopes = np.array([[end_slope(falling, 0.0), end_slope(rising, 1.0)] for rising, falling in curves])
        constants = {
            "up": reals(up, "[axis][1][piece, power], ascending curve"),
            "up_breaks": reals(up_breaks, "normalized input"),
            "up_size": integers(up_size, "pieces, order"),
            "down": reals(down, "[axis][1][piece, power], descending curve"),
            "down_breaks": reals(down_breaks, "normalized input"),
            "down_size": integers(down_size, "pieces, order"),
            "end_slope": reals(slopes, "below 0 and above the end of the input"),
            "lower": reals(lower, "V, lower end of the curves"),
            "span": reals(span, "V"),
            "scale": reals(scale, "output unit"),
        }
        return CCode("mean curve", C["MEAN"], constants=constants, functions=(MAXIMUM, MINIMUM, EVALUATE))

    def filter(self, sampling: Sampling) -> MadelungFilter:
        return MadelungFilter(self, sampling)
