# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Play (backlash) operators, and the Prandtl-Ishlinskii models made of them.

The play operator with threshold r (HAMPI paper Eq. 3) and its one-sided form, for drives that never go negative:

    two-sided   H[k] = max(u[k] - r, min(u[k] + r, H[k-1]))
    one-sided   H[k] = max(u[k] - r, min(u[k],     H[k-1]))

Both are rate-independent, wipe out inner loops and start from H = 0, the virgin state at 0 V.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from numba import njit

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.chain.c_code.c_code import CCode, reals
from hyst_control.chain.c_code.texts import c_texts
from hyst_control.chain.chain import Parallel
from hyst_control.chain.parameter import ScalarPerAxis, Scattering, VectorPerAxis, flag, scalar, vector
from hyst_control.chain.stage import (
    Filter,
    Role,
    Sampling,
    Stage,
    depth,
    frozen,
    per_axis,
    per_axis_scalar,
    per_axis_scalars,
    register,
    scaled,
)

C = c_texts(__file__)
SETTLE = C["SETTLE"]


@njit(cache=True, error_model="numpy")
def dynamic_prandtl_ishlinskii(
    command: Array,
    previous: Array,
    rate_factor: float,
    thresholds: Array,
    release: Array,
    weights: Array,
    w0: Array,
    m1: Array,
    m2: Array,
    k: Array,
    b: Array,
    levels: Array | None,
    center: Array,
    state: Array,
    output: Array,
) -> None:
    """Weighted play operators with dynamic weights, all axes (HAMPI paper Eq. 2-6; levels are an extension).

    y = w0 u + sum_i (w_i + levels_i (u - center) + w_r(du/dt) + k u + b) H_i, with w_r = -m1 du/dt while rising and +m2 du/dt while
    falling.

    command (N, A), previous (A,) the command one sample earlier, rate_factor 1 / sample_time (1/s); thresholds, release,
    weights, levels and state (A, n), or levels None; w0, m1, m2, k, b, center (A,); output (N, A). Where all but the
    weights are 0 it is the classical model.
    """
    for row in range(command.shape[0]):
        for axis in range(command.shape[1]):
            u = command[row, axis]
            total = 0.0
            weighted = 0.0
            for i in range(thresholds.shape[1]):
                low = u - thresholds[axis, i]
                high = u + release[axis, i]
                h = state[axis, i]
                h = high if h > high else h
                h = low if h < low else h
                state[axis, i] = h
                total += h
                weighted += weights[axis, i] * h
            if levels is not None:  # numba compiles one function for each case
                level = u - center[axis]
                weighted = 0.0
                for i in range(thresholds.shape[1]):
                    weighted += (weights[axis, i] + levels[axis, i] * level) * state[axis, i]
            rate = (u - previous[axis]) * rate_factor
            previous[axis] = u
            rotation = -m1[axis] * rate if rate >= 0.0 else m2[axis] * rate
            output[row, axis] = w0[axis] * u + weighted + (rotation + k[axis] * u + b[axis]) * total


class OperatorFilter(Filter):
    """Streaming play operators: thresholds, weights and state of all axes, at rest at 0."""

    def __init__(self, sampling: Sampling, thresholds: VectorPerAxis, weights: VectorPerAxis) -> None:
        axes = sampling.axes
        operators = _operators(thresholds, weights, axes)
        count = max(len(r) for r, _ in operators)
        self.hold = sampling.hold
        # Axes with fewer operators are filled up with operators of weight 0 that never leave 0: they must not enter the sum.
        self.thresholds, self.weights = np.full((axes, count), np.inf), np.zeros((axes, count))
        for axis, (r, w) in enumerate(operators):
            self.thresholds[axis, : len(r)], self.weights[axis, : len(w)] = r, w
        self.state, self.previous = np.zeros((axes, count)), np.zeros(axes)
        self.rate_factor = 1.0 / sampling.sample_time

    def settle(self, value: Array) -> Array:
        self.state[:] = 0.0
        self.previous[:] = value
        return np.asarray(self.process(np.array(value, dtype=float).reshape(1, -1))[0])


class PlayFilter(OperatorFilter):
    """Streaming Prandtl-Ishlinskii model, classical or with dynamic weights; coefficients that are not given are 0."""

    def __init__(
        self,
        sampling: Sampling,
        thresholds: VectorPerAxis,
        weights: VectorPerAxis,
        one_sided: bool,
        levels: VectorPerAxis | None = None,
        **coefficients: ScalarPerAxis,
    ) -> None:
        super().__init__(sampling, thresholds, weights)
        self.release = np.where(np.isfinite(self.thresholds), 0.0, np.inf) if one_sided else self.thresholds.copy()
        names = ("w0", "m1", "m2", "k", "b")
        w0, m1, m2, k, b = (per_axis_scalar(coefficients.get(name, 0.0), sampling.axes, name) for name in names)
        self.coefficients = (w0, m1, m2, k, b)
        self.center = per_axis_scalar(coefficients.get("center", 0.0), sampling.axes, "center")
        self.levels = np.zeros_like(self.weights)
        for axis, own in enumerate(() if levels is None else per_axis(levels, sampling.axes, 1, "levels")):
            self.levels[axis, : len(own)] = own
        self.leveled = levels is not None

    def process(self, block: Array) -> Array:
        output, operators = np.empty_like(block), (self.thresholds, self.release, self.weights)
        levels = self.levels if self.leveled else None
        dynamic_prandtl_ishlinskii(
            block, self.previous, self.rate_factor, *operators, *self.coefficients, levels, self.center, self.state, output
        )
        return output

    def c_code(self) -> CCode:
        w0, m1, m2, k, b = self.coefficients
        return CCode(
            "play operators",
            C["STEP"],
            SETTLE,
            {"COUNT": self.thresholds.shape[1]},
            {
                "thresholds": reals(self.thresholds, "input unit"),
                "release": reals(self.release, "input unit: as the thresholds, or 0 of one-sided operators"),
                "weights": reals(self.weights, "output unit / input unit"),
                "w0": reals(w0, "output unit / input unit, weight of the input itself"),
                "m1": reals(m1, "output unit s / V^2, rotation while the input rises"),
                "m2": reals(m2, "output unit s / V^2, rotation while the input falls"),
                "k": reals(k, "output unit / V^2, change of every weight with the input"),
                "b": reals(b, "output unit / V, part common to all weights"),
                "levels": reals(self.levels, "output unit / V^2, change of a weight with the input"),
                "center": reals(self.center, "V, input at which the weights are as stated"),
                "rate_factor": reals(self.rate_factor, "1/s, of two samples' difference"),
            },
            {"operators": reals(self.state, "input unit"), "previous": reals(self.previous, "input unit, input before")},
        )


def check_operators(thresholds: VectorPerAxis, weights: VectorPerAxis, name: str = "weights") -> None:
    """Raise `InputError` unless the thresholds increase, with one of the weights each."""
    axes = max(len(value) if depth(value) == 2 else 1 for value in (thresholds, weights))
    for axis, (r, w) in enumerate(_operators(thresholds, weights, axes)):
        where = f" of axis {axis}" if axes > 1 else ""
        if np.any(np.diff(r) <= 0):
            i = int(np.argmax(np.diff(r) <= 0))
            raise InputError(f"thresholds{where}: {r[i]:g} V is followed by {r[i + 1]:g} V: list them strictly increasing")
        if len(r) != len(w):
            raise InputError(f"{name}{where}: {len(w)} {name} for {len(r)} thresholds: give one each")


def _operators(thresholds: VectorPerAxis, weights: VectorPerAxis, axes: int) -> list[tuple[Array, Array]]:
    """Thresholds and weights of each axis."""
    return list(zip(per_axis(thresholds, axes, 1, "thresholds"), per_axis(weights, axes, 1, "weights"), strict=True))


@register
@dataclass(frozen=True)
class PlayOperator(Stage):
    """One play operator of unit slope: backlash with half-width `threshold` (input unit). HAMPI paper Eq. 3."""

    name: ClassVar[str] = "play_operator"
    equation: ClassVar[str] = r"y_k = \max\left(u_k - \mathrm{threshold}, \min\left(u_k + \mathrm{threshold}, y_{k-1}\right)\right)"
    ROLES: ClassVar[Role] = Role.HYSTERESIS
    threshold: ScalarPerAxis = scalar("input unit", "half-width", lower=0.0)
    one_sided: bool = flag("whether it is pulled down without play")

    def mean_slope(self, axes: int) -> Array:
        return np.ones(axes)

    def with_loop_width(self, width: Array) -> PrandtlIshlinskii:
        thresholds = [[r] for r in per_axis_scalar(self.threshold, len(width), "threshold")]
        return PrandtlIshlinskii(thresholds, (1.0 + width)[:, None], frozen(-width), self.one_sided)

    def filter(self, sampling: Sampling) -> PlayFilter:
        thresholds = tuple((r,) for r in per_axis_scalar(self.threshold, sampling.axes, "threshold"))
        return PlayFilter(sampling, thresholds, (1.0,), self.one_sided)


@dataclass(frozen=True)
class OperatorModel(Stage):
    """Common part of the models of weighted play operators, which have `w0` besides."""

    ROLES: ClassVar[Role] = Role.HYSTERESIS | Role.HAS_COMPENSATOR

    thresholds: VectorPerAxis = vector("V", "of the operators, increasing", lower=0.0)
    weights: VectorPerAxis = vector("output unit / V", "of the operators")

    def check(self) -> None:
        check_operators(self.thresholds, self.weights)

    def with_loop_width(self, width: Array) -> Stage:
        """Wider loops: what the operators gain, the command itself loses."""
        slope = np.array([weights.sum() for weights in per_axis(self.weights, len(width), 1, "weights")])
        (w0,) = per_axis_scalars(self, len(width), "w0")
        changed: dict[str, Any] = {"weights": scaled(self.weights, 1.0 + width, 1, "weights"), "w0": frozen(w0 - width * slope)}
        return replace(self, **changed)

    def with_operators(self, thresholds: Array, weights: Array) -> Stage:
        """The stage with factors (A,) of its thresholds, and of its weights but for the first operator's."""
        changed: dict[str, Any] = {"thresholds": scaled(self.thresholds, thresholds, 1, "thresholds")}
        return replace(self, **changed, weights=_with_factors(self.weights, weights, "weights"))

    def mean_slope(self, axes: int) -> Array:
        """Slope (A,) of a model in which every operator moves, on each of `axes` axes."""
        weights = per_axis(self.weights, axes, 1, "weights")
        return np.array([item.sum() for item in weights]) + per_axis_scalars(self, axes, "w0")[0]


def _with_factors(values: VectorPerAxis, factors: Array, name: str) -> Any:
    """Values of operators with factors (A,) for all but the first operator's."""
    own = per_axis(values, len(factors), 1, name)
    changed = [np.concatenate([row[:1], factor * row[1:]]) for row, factor in zip(own, factors, strict=True)]
    return frozen(changed if len(factors) > 1 else changed[0])


@register
@dataclass(frozen=True)
class PrandtlIshlinskii(OperatorModel):
    """Classical Prandtl-Ishlinskii model, y = w0 u + sum_i w_i H_i[u] (HAMPI paper Eq. 2, 3)."""

    name: ClassVar[str] = "prandtl_ishlinskii"
    equation: ClassVar[str] = (
        r"y = \mathrm{w0}\, u + \sum_i \mathrm{weights}_i\, H_i[u], \quad H_i \text{ a play operator of half-width } "
        r"\mathrm{thresholds}_i"
    )
    w0: ScalarPerAxis = scalar("output unit / V", "weight of the command itself", default=0.0)
    one_sided: bool = flag("whether the operators are pulled down without play, for drives that never go negative")

    def filter(self, sampling: Sampling) -> PlayFilter:
        return PlayFilter(sampling, self.thresholds, self.weights, self.one_sided, w0=self.w0)


@register
@dataclass(frozen=True)
class ModifiedPrandtlIshlinskii(OperatorModel):
    """Prandtl-Ishlinskii model with dynamic weights (HAMPI paper Eq. 4-6): y = w0 u + sum_i (w_i + w_r + w_a) H_i[u].

    w_r = -m1 du/dt while the command rises and +m2 du/dt while it falls; w_a = k u + b. Under `zoh` du/dt is the backward
    difference of the held command, under `foh` the slope of the segment that ends at the sample. `levels` is an extension: the paper
    has one k for all weights, where those of an asymmetric hysteresis change by different amounts.
    """

    name: ClassVar[str] = "modified_prandtl_ishlinskii"
    equation: ClassVar[str] = (
        r"y = \mathrm{w0}\, u + \sum_i \left(\mathrm{weights}_i + w_r + w_a\right) H_i[u], \quad w_r = -\mathrm{m1}\, "
        r"\dot{u} \text{ for } \dot{u} > 0, \quad +\mathrm{m2}\, \dot{u} \text{ for } \dot{u} < 0, \quad w_a = "
        r"\mathrm{k}\, u + \mathrm{b} + \mathrm{levels}_i \left(u - \mathrm{center}\right)"
    )
    m1: ScalarPerAxis = scalar("output unit s / V²", "rotation of the loop while the command rises", default=0.0)
    m2: ScalarPerAxis = scalar("output unit s / V²", "rotation of the loop while the command falls", default=0.0)
    k: ScalarPerAxis = scalar("output unit / V²", "change of every weight with the command", default=0.0)
    b: ScalarPerAxis = scalar("output unit / V", "part common to all weights", default=0.0)
    w0: ScalarPerAxis = scalar("output unit / V", "weight of the command itself", default=0.0)
    one_sided: bool = flag("whether the operators are pulled down without play, for drives that never go negative")
    levels: VectorPerAxis | None = vector("output unit / V²", "change of each weight with the command; default none", default=None)
    center: ScalarPerAxis = scalar("V", "command at which the weights are as stated", default=0.0, scatter=Scattering.NONE)

    def check(self) -> None:
        super().check()
        if self.levels is not None:
            check_operators(self.thresholds, self.levels, "levels")

    def with_operators(self, thresholds: Array, weights: Array) -> Stage:
        levels = None if self.levels is None else _with_factors(self.levels, weights, "levels")
        return OperatorModel.with_operators(replace(self, levels=levels), thresholds, weights)

    def with_loop_width(self, width: Array) -> Parallel:
        """The model once more with every operator replaced by the command takes the mean curve off."""
        return Parallel(((self._with_share(1.0 + width),), (self._mean(len(width))._with_share(-width),)))

    def with_rate_part(self, factor: Array) -> ModifiedPrandtlIshlinskii | None:
        return self.with_rate_parts(factor, factor)

    def with_rate_parts(self, rising: Array, falling: Array) -> ModifiedPrandtlIshlinskii | None:
        if not any(np.any(values) for values in per_axis_scalars(self, len(rising), "m1", "m2")):
            return None
        return replace(self, m1=scaled(self.m1, rising, 0, "m1"), m2=scaled(self.m2, falling, 0, "m2"))

    def _with_share(self, share: Array) -> ModifiedPrandtlIshlinskii:
        """The model's output times a share (A,)."""
        rest = {name: scaled(getattr(self, name), share, 0, name) for name in ("m1", "m2", "k", "b", "w0")}
        levels = None if self.levels is None else scaled(self.levels, share, 1, "levels")
        return replace(self, weights=scaled(self.weights, share, 1, "weights"), levels=levels, **rest)

    def _mean(self, axes: int) -> ModifiedPrandtlIshlinskii:
        """The model with u in place of every H_i[u]: one operator of threshold 0, with the sum of the weights."""
        weights = per_axis(self.weights, axes, 1, "weights")
        count = np.array([float(len(item)) for item in weights])
        rest = {name: scaled(getattr(self, name), count, 0, name) for name in ("m1", "m2", "k", "b")}
        levels = None if self.levels is None else [[item.sum()] for item in per_axis(self.levels, axes, 1, "levels")]
        return replace(self, thresholds=(0.0,), weights=[[item.sum()] for item in weights], levels=levels, **rest)

    def filter(self, sampling: Sampling) -> PlayFilter:
        coefficients = {name: getattr(self, name) for name in ("w0", "m1", "m2", "k", "b", "center")}
        return PlayFilter(sampling, self.thresholds, self.weights, self.one_sided, self.levels, **coefficients)
