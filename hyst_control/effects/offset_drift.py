# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A zero that drifts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

from hyst_control.base.arrays import Array
from hyst_control.chain.c_code.c_code import CCode
from hyst_control.chain.parameter import ScalarPerAxis, Scattering, scalar
from hyst_control.chain.stage import per_axis_scalars, register
from hyst_control.effects.effect import Companion, Effect, Parameter
from hyst_control.effects.gain_drift import (
    PART,
    Drift,
    arrived,
    drift_code,
    drift_course,
    drift_parameters,
    drift_variants,
    in_the_end,
    stage_values,
)


@register
@dataclass(frozen=True)
class OffsetDrift(Drift):
    """Zero that changes from `onset` on; a: the part of the change that has come; initial -1: it settles at the model's zero."""

    name: ClassVar[str] = "offset_drift"
    equation: ClassVar[str] = r"y(t) = u(t) + \mathrm{change} \left(\mathrm{initial} + a(t)\right), " + PART
    change: ScalarPerAxis = scalar("measurement unit", "of the zero in the end", scatter=Scattering.ABSOLUTE)

    def function(self, axes: int) -> Callable[[Array, Array], Array]:
        change, initial = per_axis_scalars(self, axes, "change", "initial")
        course = drift_course(self, axes)
        return lambda u, t: u + change * (initial + arrived(t[:, 0], course))

    def function_in_c(self, axes: int) -> CCode:
        return drift_code(self, axes, "u + (p->change[i] * (p->initial[i] + SHARE))", "offset drift")


EFFECT = Effect(
    "offset_drift",
    "sensor",
    "The zero changes over the record.",
    lambda around: (
        Parameter("change", "unit", 0.0, (0.01 * around.stroke,), -0.5 * around.stroke, 0.5 * around.stroke, 0.03 * around.stroke),
        *drift_parameters(around, around.begin),
    ),
    lambda values, around: OffsetDrift(**stage_values({"span": around.duration, **values})),
    # A straight one over the whole record is the drift of a session, which every explanation has.
    variants=lambda around: (drift_variants(around)[0], *drift_variants(around)[2:]),
    summary=in_the_end,
    ends_as="offset",
    companion=Companion(1, "change", 2.0, beyond="onset"),
    phrase="an offset drift of {change}",
)
