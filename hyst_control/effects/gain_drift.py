"""A gain that drifts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hyst_control.chain.c_code import CCode, each_axis
from hyst_control.chain.parameter import Array, ScalarPerAxis, scalar
from hyst_control.chain.stage import per_axis_scalars, register
from hyst_control.effects.effect import Effect, Parameter, Surroundings
from hyst_control.effects.time_dependent import TimedStage, relaxed

STEPS = (np.arange(6) + 0.5) / 6.0 - 0.5


@register
@dataclass(frozen=True)
class GainDrift(TimedStage):
    """y = u (1 + change (initial + a(t))), t from the start of the record; a: see `arrived`; initial -1: settles at the model's gain."""

    name: ClassVar[str] = "gain_drift"
    change: ScalarPerAxis = scalar("", "of the gain in the end")
    tau: ScalarPerAxis = scalar("s", "time constant, the geometric mean of several", above=0.0)
    decades: ScalarPerAxis = scalar("", "over which several time constants are spread; 0: one", default=0.0, lower=0.0, upper=20.0)
    initial: ScalarPerAxis = scalar("", "part of the change that is there at the start", default=0.0)

    def function(self, axes: int) -> Callable[[Array, Array], Array]:
        change, tau, decades, initial = per_axis_scalars(self, axes, "change", "tau", "decades", "initial")
        return lambda u, t: u * (1.0 + change * (initial + arrived(t, tau, decades)))

    def function_in_c(self, axes: int) -> CCode | None:
        change, tau, decades, initial = per_axis_scalars(self, axes, "change", "tau", "decades", "initial")
        if decades.any() or initial.any():
            return None
        return each_axis(
            "u * (R(1.0) - (p->change[i] * (real)expm1(-t / (double)p->tau[i])))",
            "gain drift",
            {"change": (change, "in the end"), "tau": (tau, "s")},
        )


def arrived(times: Array, tau: Array, decades: Array) -> Array:
    """Share of a drift that has come: the mean of 1 - exp(-t / τ_i) over 6 time constants spread over `decades` around `tau`.

    Parameters
    ----------
    times
        (N, 1), s.
    tau, decades
        (A,), s and decimal logarithm; 0 decades: one time constant.
    """
    if not decades.any():
        return -relaxed(-times / tau)
    share: Array = np.mean([-np.expm1(-times / (tau * 10.0 ** (decades * step))) for step in STEPS], axis=0)
    return share


def drift_parameters(around: Surroundings) -> tuple[Parameter, ...]:
    """Time constant of a drift, from a twentieth of the record to so long that the drift is straight; spread and initial part.

    Parameters
    ----------
    around
        Record that the sizes are judged by.
    """
    length = around.duration
    return (
        Parameter("tau", "s", length, (0.2 * length, length), 0.05 * length, 10.0 * length, 1.0, True),
        Parameter("decades", "", 0.0, (0.0, 1.5), 0.0, 3.0, 1.0, told=False),
        Parameter("initial", "", 0.0, (0.0,), -1.0, 0.0, 0.5, told=False),
    )


EFFECT = Effect(
    "gain_drift",
    "sensor",
    "The gain changes over the record.",
    lambda around: (Parameter("change", "", 0.0, (0.01,), -0.3, 0.3, 0.03), *drift_parameters(around)),
    lambda values, around: GainDrift(values["change"], values["tau"], values.get("decades", 0.0), values.get("initial", 0.0)),
    also_at=("drive",),
    phrase="a gain drift of {change}",
)
