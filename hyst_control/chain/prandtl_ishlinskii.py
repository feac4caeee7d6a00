"""Play (backlash) operators, and the Prandtl-Ishlinskii models made of them.

The play operator with threshold r (HAMPI paper Eq. 3) and its one-sided form, for drives that never go negative:

    two-sided   H[k] = max(u[k] - r, min(u[k] + r, H[k-1]))
    one-sided   H[k] = max(u[k] - r, min(u[k],     H[k-1]))

Both are rate-independent, wipe out inner loops and start from H = 0, the virgin state at 0 V.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numba import njit

from hyst_control.chain.stage import (
    Array,
    Filter,
    Sampling,
    Stage,
    depth,
    per_axis,
    per_axis_scalar,
    register,
    require_finite,
    require_positive,
)
from hyst_control.errors import InputError


@njit(cache=True, error_model="numpy")
def play_operators(command, thresholds, release, state, output):
    """Outputs (N, n) of n play operators for a command (N,); `state` (n,) is H at the sample before, and is updated.

    `release` (n,) is the distance at which an operator is pulled down: the threshold (two-sided) or 0 (one-sided).
    """
    for k in range(command.size):
        u = command[k]
        for i in range(thresholds.size):
            low = u - thresholds[i]
            high = u + release[i]
            h = state[i]
            h = high if h > high else h
            h = low if h < low else h
            state[i] = h
            output[k, i] = h


@njit(cache=True, error_model="numpy")
def dynamic_prandtl_ishlinskii(command, previous, rate_factor, thresholds, release, weights, w0, m1, m2, k, b, state, output):
    """Weighted play operators with dynamic weights, all axes (HAMPI paper Eq. 2-6).

    y = w0 u + sum_i (w_i + w_r(du/dt) + k u + b) H_i, with w_r = -m1 du/dt while rising and +m2 du/dt while falling.

    command (N, A), previous (A,) the command one sample earlier, rate_factor 1 / sample_time (1/s); thresholds, release,
    weights and state (A, n); w0, m1, m2, k, b (A,); output (N, A). With m1 = m2 = k = b = 0 it is the classical model.
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
            rate = (u - previous[axis]) * rate_factor
            previous[axis] = u
            rotation = -m1[axis] * rate if rate >= 0.0 else m2[axis] * rate
            output[row, axis] = w0[axis] * u + weighted + (rotation + k[axis] * u + b[axis]) * total


class PlayFilter(Filter):
    """Streaming Prandtl-Ishlinskii model, classical or with dynamic weights."""

    def __init__(
        self, sampling: Sampling, thresholds: list[Array], weights: list[Array], one_sided: bool, coefficients: dict[str, Array]
    ) -> None:
        axes = sampling.axes
        count = max(len(r) for r in thresholds)
        self.hold = sampling.hold
        # Axes with fewer operators are filled up with operators of weight 0 that never leave 0: they must not enter the sum.
        self.thresholds = np.full((axes, count), np.inf)
        self.weights = np.zeros((axes, count))
        for axis, (r, w) in enumerate(zip(thresholds, weights, strict=True)):
            self.thresholds[axis, : len(r)] = r
            self.weights[axis, : len(w)] = w
        self.release = np.where(np.isfinite(self.thresholds), 0.0, np.inf) if one_sided else self.thresholds.copy()
        self.state = np.zeros((axes, count))
        self.previous = np.zeros(axes)
        self.coefficients = tuple(coefficients[key] for key in ("w0", "m1", "m2", "k", "b"))
        self.rate_factor = 1.0 / sampling.sample_time

    def settle(self, value: Array) -> Array:
        self.state[:] = 0.0
        self.previous[:] = value
        return self.process(np.array(value, dtype=float).reshape(1, -1))[0]

    def process(self, block: Array) -> Array:
        output = np.empty_like(block)
        w0, m1, m2, k, b = self.coefficients
        dynamic_prandtl_ishlinskii(
            block,
            self.previous,
            self.rate_factor,
            self.thresholds,
            self.release,
            self.weights,
            w0,
            m1,
            m2,
            k,
            b,
            self.state,
            output,
        )
        return output


def check_operators(thresholds: Any, weights: Any) -> None:
    """Raise `InputError` unless the thresholds are finite, not negative and increasing, with one weight each."""
    require_positive(thresholds, "thresholds", "V", zero_allowed=True)
    require_finite(weights, "weights")
    axes = max(len(value) if depth(value) == 2 else 1 for value in (thresholds, weights))
    for axis, (r, w) in enumerate(
        zip(per_axis(thresholds, axes, 1, "thresholds"), per_axis(weights, axes, 1, "weights"), strict=True)
    ):
        where = f" of axis {axis}" if axes > 1 else ""
        if np.any(np.diff(r) <= 0):
            i = int(np.argmax(np.diff(r) <= 0))
            raise InputError(f"thresholds{where}: {r[i]:g} V is followed by {r[i + 1]:g} V: list them strictly increasing")
        if len(r) != len(w):
            raise InputError(f"weights{where}: {len(w)} weights for {len(r)} thresholds: give one each")


def play_filter(stage: Any, sampling: Sampling, **coefficients: Any) -> PlayFilter:
    """A `PlayFilter` for a stage with thresholds and weights; coefficients not given are 0."""
    axes = sampling.axes
    values = {key: per_axis_scalar(coefficients.get(key, 0.0), axes, key) for key in ("w0", "m1", "m2", "k", "b")}
    return PlayFilter(
        sampling,
        per_axis(stage.thresholds, axes, 1, "thresholds"),
        per_axis(stage.weights, axes, 1, "weights"),
        stage.one_sided,
        values,
    )


@register
@dataclass(frozen=True)
class PlayOperator(Stage):
    """One play operator of unit slope: backlash with half-width `threshold` (input unit). HAMPI paper Eq. 3."""

    name: ClassVar[str] = "play_operator"
    threshold: Any
    one_sided: bool = False

    def check(self) -> None:
        require_positive(self.threshold, "threshold", "V", zero_allowed=True)

    def filter(self, sampling: Sampling) -> Filter:
        thresholds = [np.array([r]) for r in per_axis_scalar(self.threshold, sampling.axes, "threshold")]
        zero = np.zeros(sampling.axes)
        return PlayFilter(
            sampling, thresholds, [np.ones(1)] * sampling.axes, self.one_sided, dict.fromkeys(("w0", "m1", "m2", "k", "b"), zero)
        )


@register
@dataclass(frozen=True)
class PrandtlIshlinskii(Stage):
    """Classical Prandtl-Ishlinskii model, y = w0 u + sum_i w_i H_i[u] (HAMPI paper Eq. 2, 3).

    thresholds V, increasing; weights output unit / V; w0 output unit / V.
    """

    name: ClassVar[str] = "prandtl_ishlinskii"
    thresholds: Any
    weights: Any
    w0: Any = 0.0
    one_sided: bool = False

    def check(self) -> None:
        check_operators(self.thresholds, self.weights)
        require_finite(self.w0, "w0")

    def filter(self, sampling: Sampling) -> Filter:
        return play_filter(self, sampling, w0=self.w0)


@register
@dataclass(frozen=True)
class ModifiedPrandtlIshlinskii(Stage):
    """Prandtl-Ishlinskii model with dynamic weights (HAMPI paper Eq. 4-6): y = w0 u + sum_i (w_i + w_r + w_a) H_i[u].

    w_r = -m1 du/dt while the command rises and +m2 du/dt while it falls; w_a = k u + b. Under `zoh` du/dt is the backward
    difference of the held command, under `foh` the slope of the segment that ends at the sample.

    thresholds V; weights, b output unit / V; w0 output unit / V; m1, m2 output unit s / V²; k output unit / V².
    """

    name: ClassVar[str] = "modified_prandtl_ishlinskii"
    thresholds: Any
    weights: Any
    m1: Any = 0.0
    m2: Any = 0.0
    k: Any = 0.0
    b: Any = 0.0
    w0: Any = 0.0
    one_sided: bool = False

    def check(self) -> None:
        check_operators(self.thresholds, self.weights)
        for field in ("m1", "m2", "k", "b", "w0"):
            require_finite(getattr(self, field), field)

    def filter(self, sampling: Sampling) -> Filter:
        return play_filter(self, sampling, w0=self.w0, m1=self.m1, m2=self.m2, k=self.k, b=self.b)
