# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Low-passes of an amplifier or a sensor: equal first-order ones in a row, or one of second order with a damping of its own."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numba import njit

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.chain.c_code.c_code import CCode, reals
from hyst_control.chain.linear.linear_stages import LinearStage, discretise, linear_filter
from hyst_control.chain.linear.linear_system import THROUGH, LinearSystem
from hyst_control.chain.parameter import ScalarPerAxis, Scattering, scalar
from hyst_control.chain.stage import Filter, Sampling, Stage, frozen, per_axis_scalars
from hyst_control.effects.effect import Effect, Parameter, Surroundings, Values


@dataclass(frozen=True)
class Lowpass(LinearStage):
    """1 / (1 + s / (2π cutoff))^order; cutoff Hz, infinite: none on that axis. Exact: it merges with its linear neighbors.

    Of order 2 it is ω² / (s² + 2 damping ω s + ω²) with ω = 2π cutoff: damping 1 is two equal low-passes, 0.707 a Butterworth filter.
    """

    equation: ClassVar[str] = (
        r"y = \left(\frac{1}{1 + s / (2 \pi\, \mathrm{cutoff})}\right)^{\mathrm{order}} u \quad \text{for } "
        r"\mathrm{damping} = 1"
    )
    unit_gain: ClassVar[bool] = True
    cutoff: ScalarPerAxis = scalar("Hz", "of every low-pass", above=0.0, infinite=True)
    order: ScalarPerAxis = scalar("", "number of low-passes", default=1, lower=1.0, whole=True, scatter=Scattering.NONE)
    damping: ScalarPerAxis = scalar("", "of a low-pass of order 2", default=1.0, above=0.0, scatter=Scattering.NONE)

    def check(self) -> None:
        axes = max(len(value) if isinstance(value, tuple) else 1 for value in (self.order, self.damping))
        order, damping = per_axis_scalars(self, axes, "order", "damping")
        if np.any((order != 2.0) & (damping != 1.0)):
            raise InputError("damping: belongs to a low-pass of order 2: leave it out, or give order 2")

    def systems(self, axes: int) -> list[LinearSystem]:
        return [
            lowpass_system(cutoff, int(order), damping)
            for cutoff, order, damping in zip(*per_axis_scalars(self, axes, "cutoff", "order", "damping"), strict=True)
        ]


@dataclass(frozen=True)
class AtSamples(Stage):
    """The values of a linear stage's output at the ends of the intervals, handed on as if held; part of a started chain only."""

    base: LinearStage

    def filter(self, sampling: Sampling) -> Filter:
        running = linear_filter([self.base], sampling)
        running.hold = sampling.hold
        return running


@dataclass(frozen=True)
class Rebuilt(Stage):
    """The held signal that a low-pass of first or second order turns into one with the given values at the samples.

    Part of a started chain only. Backwards through the low-pass of a held signal z, whose output is, per axis,
    u_k = b1 z_k + b2 z_{k-1} - a1 u_{k-1} - a2 u_{k-2}.
    """

    cutoff: ScalarPerAxis
    order: ScalarPerAxis
    damping: ScalarPerAxis

    def filter(self, sampling: Sampling) -> Filter:
        values = per_axis_scalars(self, sampling.axes, "cutoff", "order", "damping")
        shares = [_shares(lowpass_system(f, int(n), d), sampling) for f, n, d in zip(*values, strict=True)]
        return RebuiltFilter(np.array(shares), sampling.hold)


class RebuiltFilter(Filter):
    """Streaming `Rebuilt`; shares: -a1 / b1, -a2 / b1, -b2 / b1 of every axis (A, 3)."""

    def __init__(self, shares: Array, hold: str) -> None:
        self.hold = hold
        self.shares = shares
        self.last, self.before, self.held = np.zeros((3, len(shares)))

    def settle(self, value: Array) -> Array:
        self.last, self.before, self.held = (np.array(value, dtype=float) for _ in range(3))
        return self.held.copy()

    def process(self, block: Array) -> Array:
        rebuilt = np.empty_like(block)
        _rebuild(block, self.shares, self.last, self.before, self.held, rebuilt)
        return rebuilt

    def c_code(self) -> CCode:
        return CCode(
            "rebuilt",
            """
for (int i = 0; i < AXES; i++) {
    const real value = in[i];
    real held = value + (p->last_change[i] * (value - s->last[i]));
    held += (p->both_changes[i] * (value - s->before[i])) + (p->held_before[i] * (s->held[i] - value));
    s->before[i] = s->last[i];
    s->last[i] = value;
    s->held[i] = held;
    out[i] = held;
}
""",
            """
for (int i = 0; i < AXES; i++) {
    s->before[i] = in[i];
    s->last[i] = in[i];
    s->held[i] = in[i];
    out[i] = in[i];
}
""",
            constants={
                "last_change": reals(self.shares[:, 0], "share of the change since the value before"),
                "both_changes": reals(self.shares[:, 1], "share of the change since two values before"),
                "held_before": reals(self.shares[:, 2], "share of the distance of what was held before"),
            },
            state={
                "last": reals(self.last, "signal unit, input before"),
                "before": reals(self.before, "signal unit, input before that"),
                "held": reals(self.held, "signal unit, output before"),
            },
        )


@njit(cache=True, error_model="numpy")
def _rebuild(block: Array, shares: Array, last: Array, before: Array, held: Array, rebuilt: Array) -> None:
    for k in range(block.shape[0]):
        for i in range(block.shape[1]):
            # In this order a signal at rest stays what it is to the last bit.
            value = block[k, i]
            new = value + (shares[i, 0] * (value - last[i]))
            new += (shares[i, 1] * (value - before[i])) + (shares[i, 2] * (held[i] - value))
            before[i], last[i], held[i], rebuilt[k, i] = last[i], value, new, new


def _shares(system: LinearSystem, sampling: Sampling) -> tuple[float, float, float]:
    """-a1 / b1, -a2 / b1 and -b2 / b1 of a low-pass of first or second order of a held signal; 0 without one."""
    if not len(system.A):
        return 0.0, 0.0, 0.0
    held = discretise(system, np.zeros(1), replace(sampling, hold="zoh"))
    one = float(held.C[0] @ held.B[0, :, 0])
    if len(held.A) == 1:
        return float(held.A[0, 0]) / one, 0.0, 0.0
    two = float(held.C[0] @ held.A @ held.B[0, :, 0]) - float(np.trace(held.A)) * one
    return float(np.trace(held.A)) / one, -float(np.linalg.det(held.A)) / one, -two / one


def lowpass_system(cutoff: float, order: int, damping: float) -> LinearSystem:
    """`order` first-order low-passes at `cutoff` Hz in a row, or one of second order with another damping."""
    if np.isinf(cutoff):
        return THROUGH
    rate = 2 * np.pi * cutoff
    if order == 2 and damping != 1.0:
        a = rate * np.array([[0.0, 1.0], [-1.0, -2.0 * damping]])
        return LinearSystem(a, rate * np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]]), np.zeros((1, 1)), np.zeros(1))
    a = rate * (np.eye(order, k=-1) - np.eye(order))
    return LinearSystem(a, rate * np.eye(order, 1), np.eye(order)[-1:], np.zeros((1, 1)), np.zeros(1))


def lowpass_parameters(around: Surroundings) -> tuple[Parameter, ...]:
    """Cutoff, order, and the damping of one of second order: from a tenth of the lowest excited frequency to what sampling hardly shows."""
    nyquist, slowest = 0.5 / around.sample_time, around.lowest_frequency
    starts = tuple(np.geomspace(0.3 * slowest, nyquist, 6).tolist())
    return (
        Parameter("cutoff", "Hz", np.inf, starts, 0.1 * slowest, nyquist, 1.5, logarithmic=True),
        Parameter("order", "", 1.0, (1.0, 2.0), 1.0, 2.0, 1.0),
        Parameter("damping", "", 1.0, (0.9,), 0.4, 1.1, 0.3, told=False),
    )


def lowpass_values(values: Values) -> Values:
    """Values of a low-pass whose order is 1 on some axes: they have no damping of their own there."""
    order = np.array(values.get("order", 1.0), dtype=float)
    damping = np.where(order == 2.0, np.array(values.get("damping", 1.0), dtype=float), 1.0)
    return {"cutoff": values["cutoff"], "order": frozen(order), "damping": frozen(damping)}


def lowpass_effect(name: str, place: str, meaning: str, stage: type[Lowpass], phrase: str) -> Effect:
    """The effect of a low-pass at a place."""
    return Effect(
        name,
        place,
        meaning,
        lowpass_parameters,
        lambda values, around: stage(**lowpass_values(values)),
        variants=lambda around: ({"order": 1.0, "damping": 1.0}, {"order": 2.0}),
        separating_record="the amplifier's output voltage",
        phrase=phrase,
    )
