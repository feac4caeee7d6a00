"""A zero that drifts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

from hyst_control.chain.c_code import CCode, each_axis
from hyst_control.chain.parameter import Array, ScalarPerAxis, Scattering, scalar
from hyst_control.chain.stage import per_axis_scalar, register
from hyst_control.effects.effect import Companion, Effect, Parameter
from hyst_control.effects.gain_drift import tau_parameter
from hyst_control.effects.time_dependent import TimedStage, relaxed


@register
@dataclass(frozen=True)
class OffsetDrift(TimedStage):
    """y = u + change (1 - exp(-t / tau)), t from the start of the record; change in the measurement unit, tau s."""

    name: ClassVar[str] = "offset_drift"
    change: ScalarPerAxis = scalar("measurement unit", "of the zero in the end", scatter=Scattering.ABSOLUTE)
    tau: ScalarPerAxis = scalar("s", "time constant", above=0.0)

    def function(self, axes: int) -> Callable[[Array, Array], Array]:
        change, tau = per_axis_scalar(self.change, axes, "change"), per_axis_scalar(self.tau, axes, "tau")
        return lambda u, t: u - change * relaxed(-t / tau)

    def function_in_c(self, axes: int) -> CCode:
        change, tau = per_axis_scalar(self.change, axes, "change"), per_axis_scalar(self.tau, axes, "tau")
        return each_axis(
            "u - (p->change[i] * (real)expm1(-t / (double)p->tau[i]))",
            "offset drift",
            {"change": (change, "in the end"), "tau": (tau, "s")},
        )


EFFECT = Effect(
    "offset_drift",
    "sensor",
    "The zero changes over the record.",
    lambda around: (
        Parameter("change", "unit", 0.0, (0.01 * around.stroke,), -0.5 * around.stroke, 0.5 * around.stroke, 0.03 * around.stroke),
        tau_parameter(around),
    ),
    lambda values, around: OffsetDrift(values["change"], values["tau"]),
    companion=Companion(1, "change", 2.0),
)
