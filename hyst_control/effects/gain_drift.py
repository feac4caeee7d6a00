"""A gain that drifts."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numba import njit

from hyst_control.chain.c_code import CCode, each_axis
from hyst_control.chain.parameter import Array, ScalarPerAxis, scalar
from hyst_control.chain.stage import Stage, frozen, per_axis_scalars, register
from hyst_control.effects.effect import Effect, Parameter, Surroundings, Values
from hyst_control.effects.time_dependent import TimedStage
from hyst_control.errors import InputError

STEPS = (np.arange(6) + 0.5) / 6.0 - 0.5
"""Places of the time constants in their decades."""
STRAIGHT = 10.0
"""Time constant, in lengths of the record, from which a drift is straight."""

TIME_CONSTANT = "time constant, the geometric mean of several; negative of a drift that goes ever faster"
"""The parameter `tau` of a drift's stage."""
FASTEST = 8.0
"""Length of the record, in time constants, of a drift that goes ever faster."""

ARRIVED = """
/* Share of a drift that has come at a time in s: the mean over its time constants. */
static real arrived_share(double t, const double times[], int count)
{
    double sum = 0.0;
    for (int k = 0; k < count; k++) {
        sum -= expm1(-t / times[k]);
    }
    return (real)(sum / (double)count);
}
"""
"""`arrived` in C."""


@register
@dataclass(frozen=True)
class GainDrift(TimedStage):
    """y = u (1 + change (initial + a(t))), t from the start of the record; a: see `arrived`; initial -1: settles at the model's gain."""

    name: ClassVar[str] = "gain_drift"
    equation: ClassVar[str] = r"y(t) = u(t) \left(1 + \mathrm{change} \left(\mathrm{initial} + a(t)\right)\right)"
    change: ScalarPerAxis = scalar("", "of the gain in the end")
    tau: ScalarPerAxis = scalar("s", TIME_CONSTANT)
    decades: ScalarPerAxis = scalar("", "over which several time constants are spread; 0: one", default=0.0, lower=0.0, upper=20.0)
    initial: ScalarPerAxis = scalar("", "part of the change that is there at the start", default=0.0)

    def check(self) -> None:
        check_time_constant(self.tau)

    def function(self, axes: int) -> Callable[[Array, Array], Array]:
        change, initial = per_axis_scalars(self, axes, "change", "initial")
        times = drift_times(*per_axis_scalars(self, axes, "tau", "decades"))
        return lambda u, t: u * (1.0 + change * (initial + arrived(t[:, 0], times)))

    def function_in_c(self, axes: int) -> CCode:
        return drift_code(self, axes, "u * (R(1.0) + (p->change[i] * (p->initial[i] + SHARE)))", "gain drift")


def check_time_constant(tau: ScalarPerAxis) -> None:
    """Check a drift's time constant.

    Parameters
    ----------
    tau
        s.

    Raises
    ------
    InputError
        It is 0.
    """
    if not np.all(np.asarray(tau, dtype=float)):
        raise InputError(f"tau: must not be 0 s, got {tau}")


def drift_times(tau: Array, decades: Array) -> Array:
    """Time constants (A, 1) of a drift, or (A, 6) where they are spread.

    Parameters
    ----------
    tau, decades
        (A,), s and decimal logarithm; 0 decades everywhere: one time constant.
    """
    if not decades.any():
        return np.ascontiguousarray(tau[:, None])
    spread: Array = tau[:, None] * 10.0 ** (decades[:, None] * STEPS)
    return spread


@njit(cache=True, error_model="numpy")
def arrived(times: Array, constants: Array) -> Array:
    """Share of a drift that has come: the mean of 1 - exp(-t / τ_i) over its time constants.

    Parameters
    ----------
    times
        (N,), s.
    constants
        (A, K), s; see `drift_times`.

    Returns
    -------
    ndarray
        (N, A).
    """
    axes, count = constants.shape
    output = np.empty((times.size, axes))
    for row in range(times.size):
        for axis in range(axes):
            total = 0.0
            for k in range(count):
                total -= math.expm1(-times[row] / constants[axis, k])
            output[row, axis] = total / count
    return output


def drift_code(stage: Stage, axes: int, expression: str, title: str) -> CCode:
    """C of a drift.

    Parameters
    ----------
    stage
        Drift.
    axes
        Number of axes.
    expression
        Output for the input `u` and the share `SHARE` that has come.
    title
        As in `CCode`.
    """
    change, tau, decades, initial = per_axis_scalars(stage, axes, "change", "tau", "decades", "initial")
    times = drift_times(tau, decades)
    return each_axis(
        expression.replace("SHARE", f"arrived_share(t, p->times[i], {times.shape[1]})"),
        title,
        {"change": (change, "in the end"), "initial": (initial, "part of the change that is there at the start")},
        (ARRIVED,),
        {"times": (times, "s, time constants")},
    )


def drift_parameters(around: Surroundings) -> tuple[Parameter, ...]:
    """Parameters of a drift's course.

    The time constant goes from a twentieth of the record to so long that the drift is straight. A drift that goes ever faster is a
    straight one with a growth: the record's length in time constants. A drift that has settled before the first sample that is compared
    would be a constant.

    Parameters
    ----------
    around
        Record that the sizes are judged by.
    """
    length = around.duration
    least = max(0.05 * length, around.begin)
    return (
        Parameter("tau", "s", length, (max(0.2 * length, least), length), least, STRAIGHT * length, 1.0, True),
        Parameter("decades", "", 0.0, (0.0, 1.5), 0.0, 3.0, 1.0, told=False),
        Parameter("initial", "", 0.0, (0.0,), -1.0, 0.0, 0.5, told=False),
        Parameter("span", "s", length, (length,), 0.0, STRAIGHT * length, 1.0, told=False),
        Parameter("growth", "", 0.0, (1.0,), 0.0, FASTEST, 1.0, told=False),
    )


def in_the_end(values: Values) -> dict[str, float]:
    """Change that the gap report has: in the end of a drift that settles, over the record of a straight one, which has no end.

    `change` is what comes within `span`, s: so fitted, a slow drift is as small a number as a fast one that does the same to the record.

    Parameters
    ----------
    values
        Of the parameters, by name.
    """
    if "span" not in values or _is_straight(values):
        return {}
    return {"change": float(values["change"]) / float(_share_of_span(values)[0])}


def stage_values(values: Values) -> dict[str, Any]:
    """Parameters of a drift's stage, whose change is the one in the end.

    Parameters
    ----------
    values
        Of the gap report, by name; a number for every axis alike, or a list with one per axis.
    """
    change = np.where(_is_straight(values), np.divide(values["change"], _share_of_span(values)), values["change"])
    found = {"change": change, "tau": _time_constant(values)}
    single = not any(np.ndim(value) for value in values.values())
    stage = {name: float(value.reshape(-1)[0]) if single else frozen(value) for name, value in found.items()}
    return {**stage, **{name: values.get(name, 0.0) for name in ("decades", "initial")}}


def _is_straight(values: Values) -> Any:
    return np.greater_equal(values["tau"], (1.0 - 1e-9) * STRAIGHT * np.asarray(values["span"], dtype=float))


def _time_constant(values: Values) -> Array:
    """Time constant of the stage, s: negative of a drift that goes ever faster."""
    tau, growth, span = (np.asarray(values.get(name, 0.0), dtype=float) for name in ("tau", "growth", "span"))
    slow = 1.0 / STRAIGHT
    return np.asarray(np.where(growth > slow, -span / np.maximum(growth, slow), tau), dtype=np.float64)


def _share_of_span(values: Values) -> Array:
    """Share (A,) of a drift that has come after `span`."""
    tau, decades, span = (
        np.array(value, dtype=float)
        for value in np.broadcast_arrays(_time_constant(values), values.get("decades", 0.0), values["span"])
    )
    times = drift_times(np.atleast_1d(tau), np.atleast_1d(decades))
    return np.array([arrived(np.array([end]), times)[0, axis] for axis, end in enumerate(np.atleast_1d(span))])


def drift_variants(around: Surroundings) -> tuple[Values, ...]:
    """A drift of any course; a straight one, which is one number and not four; and one that goes ever faster.

    Parameters
    ----------
    around
        Record that the sizes are judged by.
    """
    settling = {"span": around.duration, "growth": 0.0}
    straight = {"tau": STRAIGHT * around.duration, "decades": 0.0, "initial": 0.0}
    return settling, {**settling, **straight}, {"span": around.duration, **straight}


def parameters(around: Surroundings) -> tuple[Parameter, ...]:
    """Change over the record; beside the model's own error from a fifth of the gain to five times as much.

    Parameters
    ----------
    around
        Record that the sizes are judged by.
    """
    change = (
        Parameter("change", "", 0.0, (0.01,), -0.3, 0.3, 0.03)
        if around.slowest is None
        else Parameter("change", "", 0.0, (0.01,), -0.8, 4.0, 0.1)
    )
    return change, *drift_parameters(around)


EFFECT = Effect(
    "gain_drift",
    "sensor",
    "The gain changes over the record.",
    parameters,
    lambda values, around: GainDrift(**stage_values({"span": around.duration, **values})),
    variants=drift_variants,
    drifts=True,
    summary=in_the_end,
    also_at=("drive",),
    phrase="a gain drift of {change}",
)
