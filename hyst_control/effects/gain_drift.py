"""A gain that drifts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

from hyst_control.chain.c_code import CCode, each_axis
from hyst_control.chain.parameter import Array, ScalarPerAxis, scalar
from hyst_control.chain.stage import per_axis_scalar, register
from hyst_control.effects.effect import Effect, Parameter, Surroundings
from hyst_control.effects.time_dependent import TimedStage, relaxed


@register
@dataclass(frozen=True)
class GainDrift(TimedStage):
    """y = u (1 + change (1 - exp(-t / tau))), t from the start of the record; tau s."""

    name: ClassVar[str] = "gain_drift"
    change: ScalarPerAxis = scalar("", "of the gain in the end")
    tau: ScalarPerAxis = scalar("s", "time constant", above=0.0)

    def function(self, axes: int) -> Callable[[Array, Array], Array]:
        change, tau = per_axis_scalar(self.change, axes, "change"), per_axis_scalar(self.tau, axes, "tau")
        return lambda u, t: u * (1.0 - change * relaxed(-t / tau))

    def function_in_c(self, axes: int) -> CCode:
        change, tau = per_axis_scalar(self.change, axes, "change"), per_axis_scalar(self.tau, axes, "tau")
        return each_axis(
            "u * (R(1.0) - (p->change[i] * (real)expm1(-t / (double)p->tau[i])))",
            "gain drift",
            {"change": (change, "in the end"), "tau": (tau, "s")},
        )


def tau_parameter(around: Surroundings) -> Parameter:
    """Time constant of a drift: from a twentieth of the record to so long that the drift is straight.

    Parameters
    ----------
    around
        Record that the sizes are judged by.
    """
    length = around.duration
    return Parameter("tau", "s", length, (0.2 * length, length), 0.05 * length, 10.0 * length, 1.0, True)


EFFECT = Effect(
    "gain_drift",
    "sensor",
    "The gain changes over the record.",
    lambda around: (Parameter("change", "", 0.0, (0.01,), -0.3, 0.3, 0.03), tau_parameter(around)),
    lambda values, around: GainDrift(values["change"], values["tau"]),
)
