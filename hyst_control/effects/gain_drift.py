# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A gain that drifts."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np
from numba import njit

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.chain.c_code.c_code import CCode, each_axis
from hyst_control.chain.c_code.texts import c_texts
from hyst_control.chain.parameter import ScalarPerAxis, scalar
from hyst_control.chain.stage import Stage, frozen, per_axis_scalars, register
from hyst_control.effects.effect import Effect, Parameter, Surroundings, Values
from hyst_control.effects.time_dependent import TimedStage

C = c_texts(__file__)

STEPS = (np.arange(6) + 0.5) / 6.0 - 0.5  # Places of the time constants in their decades
STRAIGHT = 10.0  # Time constant, in lengths of the record, from which a drift is straight

FASTEST = 8.0  # Length of the record, in time constants, of a drift that goes ever faster
JUMPS = tuple(np.arange(0.5, 18.0) / 19.0)
"""Onsets at which fits of a jump begin, as shares of the time in which a jump is visible; each fit begins with a ramp over a twentieth of
the record."""
SHORTEST = 0.002  # Length of a drift that is a jump, in that of the record


PART = r"\quad a(t) = 1 - e^{-(t - \mathrm{onset}) / \mathrm{tau}} \text{ with } \mathrm{decades}, \mathrm{lasts} = 0"
"""Part of a drift that has come, for the equations: of one time constant and without an end; `arrived` has the others."""


@dataclass(frozen=True)
class Drift(TimedStage):
    """A change that comes with time, t from onset on, as `arrived` has it."""

    change: ScalarPerAxis = scalar("", "in the end")
    tau: ScalarPerAxis = scalar("s", "time constant, the geometric mean of several; negative of a drift that goes ever faster")
    decades: ScalarPerAxis = scalar("", "over which several time constants are spread; 0: one", default=0.0, lower=0.0, upper=20.0)
    initial: ScalarPerAxis = scalar("", "part of the change that is there at the start", default=0.0)
    onset: ScalarPerAxis = scalar("s", "time from the start of the record at which it begins", default=0.0, lower=0.0)
    lasts: ScalarPerAxis = scalar(
        "s", "time for which it goes on from there; then it stays where it is; 0: it goes on for ever", default=0.0, lower=0.0
    )
    smooth: ScalarPerAxis = scalar(
        "", "how smoothly it begins and ends: 0 with corners, 1 in an S", default=0.0, lower=0.0, upper=1.0
    )

    def check(self) -> None:
        if not np.all(np.asarray(self.tau, dtype=float)):
            raise InputError(f"tau: must not be 0 s, got {self.tau}")


@register
@dataclass(frozen=True)
class GainDrift(Drift):
    """Gain that changes from `onset` on; a: the part of the change that has come; initial -1: it settles at the model's gain."""

    name: ClassVar[str] = "gain_drift"
    equation: ClassVar[str] = r"y(t) = u(t) \left(1 + \mathrm{change} \left(\mathrm{initial} + a(t)\right)\right), " + PART
    change: ScalarPerAxis = scalar("", "of the gain in the end")

    def function(self, axes: int) -> Callable[[Array, Array], Array]:
        change, initial = per_axis_scalars(self, axes, "change", "initial")
        course = drift_course(self, axes)
        return lambda u, t: u * (1.0 + change * (initial + arrived(t[:, 0], course)))

    def function_in_c(self, axes: int) -> CCode:
        return drift_code(self, axes, "u * (R(1.0) + (p->change[i] * (p->initial[i] + SHARE)))", "gain drift")


def drift_times(tau: Annotated[Array, "A"], decades: Annotated[Array, "A"]) -> Array:
    """Time constants (A, 1) of a drift, or (A, 6) where they are spread."""
    if not decades.any():
        return np.ascontiguousarray(tau[:, None])
    spread: Array = tau[:, None] * 10.0 ** (decades[:, None] * STEPS)
    return spread


Course = tuple[Array, Array, Array, Array]
"""Time constants (A, K), onset, length (0: to the end) and smoothness (A,) of a drift."""


@njit(cache=True, error_model="numpy")
def arrived(times: Annotated[Array, "N"], course: Course) -> Annotated[Array, "N A"]:
    """Share of a drift that has come: the mean of 1 - exp(-t / τ_i) over its time constants, t from the onset on and up to its end.

    Between the two t goes as x + smooth (S(x) - x), S(x) = 3 x² - 2 x³, x the part of that time that is over.
    """
    constants, onset, lasts, smooth = course
    axes, count = constants.shape
    output = np.empty((times.size, axes))
    for row in range(times.size):
        for axis in range(axes):
            total, time = 0.0, max(times[row] - onset[axis], 0.0)
            if lasts[axis] > 0.0:
                x = min(time / lasts[axis], 1.0)
                time = lasts[axis] * (x + smooth[axis] * x * (1.0 - x) * (2.0 * x - 1.0))
            for k in range(count):
                total -= math.expm1(-time / constants[axis, k])
            output[row, axis] = total / count
    return output


def drift_course(stage: Stage, axes: int) -> Course:
    """Time constants (A, K), onset, duration (s) and smoothness (A,) of a drift, as `arrived` takes them."""
    tau, decades = per_axis_scalars(stage, axes, "tau", "decades")
    onset, lasts, smooth = per_axis_scalars(stage, axes, "onset", "lasts", "smooth")
    return drift_times(tau, decades), onset, lasts, smooth


def drift_code(stage: Stage, axes: int, expression: str, title: str) -> CCode:
    """C of a drift."""
    change, initial = per_axis_scalars(stage, axes, "change", "initial")
    times, *course = drift_course(stage, axes)
    return each_axis(
        expression.replace(
            "SHARE", f"arrived_share(t, p->course[i][0], p->course[i][1], p->course[i][2], p->times[i], {times.shape[1]})"
        ),
        title,
        {"change": (change, "in the end"), "initial": (initial, "part of the change that is there at the start")},
        (C["ARRIVED"],),
        {
            "times": (times, "s, time constants"),
            "course": (np.column_stack(course), "s, s and 1: onset, how long it goes on if not 0, smoothness"),
        },
    )


def drift_parameters(around: Surroundings, first: float) -> tuple[Parameter, ...]:
    """Parameters of a drift's course; `first`, s: from which on one that begins within the record may do so.

    The time constant goes from a twentieth of the record to so long that the drift is straight. A drift that goes ever faster is a
    straight one with a growth: the record's length in time constants. A drift that begins or ends within the record is a straight one
    between the two, or goes in an S: which is near to any other that does; a jump is one of next to no length. A drift that has settled
    before the first sample that is compared would be a constant.
    """
    length = around.duration
    least = max(0.05 * length, around.begin)
    # A corner is found from nearby alone, and a jump from a drift that has it in it.
    jumps = tuple(first + share * (length - first) for share in JUMPS)
    slow = tuple(max(share * length, least) for share in (0.15, 0.3, 0.5, 0.85))
    return (
        Parameter("tau", "s", length, (max(0.2 * length, least), length), least, STRAIGHT * length, 1.0, True),
        Parameter("decades", "", 0.0, (0.0, 1.5), 0.0, 3.0, 1.0, told=False),
        Parameter("initial", "", 0.0, (0.0,), -1.0, 0.0, 0.5, told=False),
        Parameter("span", "s", length, (length,), 0.0, STRAIGHT * length, 1.0, told=False),
        Parameter("growth", "", 0.0, (1.0,), 0.0, FASTEST, 1.0, told=False),
        Parameter("onset", "s", 0.0, (first, *(len(slow) - 1) * (0.4 * length,), *jumps), first, 0.98 * length, 0.3 * length),
        Parameter("lasts", "s", length, (*slow, *len(jumps) * (0.05 * length,)), SHORTEST * length, length, 0.3 * length),
        Parameter("smooth", "", 0.0, (0.5,), 0.0, 1.0, 0.5, told=False),
    )


def in_the_end(values: Values) -> dict[str, float]:
    """Change that the gap report has: in the end of a drift that settles, over the record of a straight one, which has no end.

    `change` is what comes within `span`, s: so fitted, a slow drift is as small a number as a fast one that does the same to the record.
    """
    if "span" not in values or _is_straight(values):
        return {}
    return {"change": float(values["change"]) / float(_share_of_span(values)[0])}


def stage_values(values: Values) -> dict[str, Any]:
    """Parameters of a drift's stage, whose change is the one in the end."""
    change = np.where(_is_straight(values), np.divide(values["change"], _share_of_span(values)), values["change"])
    found = {"change": change, "tau": _time_constant(values)}
    single = not any(np.ndim(value) for value in values.values())
    stage = {name: float(value.reshape(-1)[0]) if single else frozen(value) for name, value in found.items()}
    return {**stage, **{name: values.get(name, 0.0) for name in ("decades", "initial", "smooth")}, **_times(values)}


def _times(values: Values) -> dict[str, Any]:
    """Onset and length of a stage, s: one that has no end has length 0."""
    onset, lasts = (np.asarray(values.get(name, 0.0), dtype=float) for name in ("onset", "lasts"))
    found = {"onset": np.maximum(onset, 0.0), "lasts": np.where(np.isinf(lasts), 0.0, lasts)}
    return {name: frozen(value) if value.ndim else float(value) for name, value in found.items()}


def _is_straight(values: Values) -> Any:
    return np.greater_equal(values["tau"], (1.0 - 1e-9) * STRAIGHT * np.asarray(values["span"], dtype=float))


def _time_constant(values: Values) -> Array:
    """Time constant of the stage, s: negative of a drift that goes ever faster."""
    tau, growth, span = (np.asarray(values.get(name, 0.0), dtype=float) for name in ("tau", "growth", "span"))
    slow = 1.0 / STRAIGHT
    settling = np.where(np.isinf(tau), STRAIGHT * span, tau)
    return np.asarray(np.where(growth > slow, -span / np.maximum(growth, slow), settling), dtype=np.float64)


def _share_of_span(values: Values) -> Array:
    """Share (A,) of a drift that has come after `span`."""
    tau, decades, onset, lasts, smooth, span = (
        np.atleast_1d(np.array(value, dtype=float))
        for value in np.broadcast_arrays(
            _time_constant(values), values.get("decades", 0.0), *_times(values).values(), values.get("smooth", 0.0), values["span"]
        )
    )
    times = drift_times(tau, decades)
    return np.array([arrived(np.array([end]), (times, onset, lasts, smooth))[0, axis] for axis, end in enumerate(span)])


def drift_variants(around: Surroundings) -> tuple[Values, ...]:
    """A drift of any course; a straight one, which is one number and not four; one that goes ever faster; two within the record."""
    whole = {"span": around.duration, "onset": -np.inf, "lasts": np.inf, "smooth": 0.0}
    straight = {"tau": np.inf, "decades": 0.0, "initial": 0.0}
    return (
        {**whole, "growth": 0.0},
        {**whole, **straight, "growth": 0.0},
        {**whole, **straight},
        {"span": around.duration, **straight, "growth": 0.0, "onset": -np.inf, "smooth": 0.0},
        {"span": around.duration, **straight, "growth": 0.0},
    )


def parameters(around: Surroundings) -> tuple[Parameter, ...]:
    """Change over the record, from a fifth of the gain to five times as much."""
    change = Parameter("change", "", 0.0, (0.01,), -0.8, 4.0, 0.1)
    return change, *drift_parameters(around, min(around.moved, 0.9 * around.duration))


EFFECT = Effect(
    "gain_drift",
    "sensor",
    "The gain changes over the record.",
    parameters,
    lambda values, around: GainDrift(**stage_values({"span": around.duration, **values})),
    variants=drift_variants,
    ends_as="gain",
    summary=in_the_end,
    also_at=("drive",),
    phrase="a gain drift of {change}",
)
