# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A drive that does not answer small commands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hyst_control.chain.c_code.c_code import MAXIMUM, MINIMUM, each_axis
from hyst_control.chain.memoryless import StaticFilter
from hyst_control.chain.parameter import ScalarPerAxis, scalar
from hyst_control.chain.stage import Filter, Sampling, Stage, per_axis_scalars, register
from hyst_control.effects.effect import Effect, Parameter, Surroundings


@register
@dataclass(frozen=True)
class DeadZone(Stage):
    """Answers nothing within ± half_width of `center`; beyond, the output falls short by as much."""

    name: ClassVar[str] = "dead_zone"
    equation: ClassVar[str] = (
        r"y = u - \min\left(\max\left(u - \mathrm{center}, -\mathrm{half\_width}\right), \mathrm{half\_width}\right)"
    )
    place: ClassVar[str] = "drive"
    half_width: ScalarPerAxis = scalar("V", "of the zone", lower=0.0)
    center: ScalarPerAxis = scalar("V", "of the zone", default=0.0)

    def filter(self, sampling: Sampling) -> Filter:
        half, center = per_axis_scalars(self, sampling.axes, "half_width", "center")
        code = each_axis(
            "u - minimum_of(maximum_of(u - p->center[i], -p->half[i]), p->half[i])",
            "dead zone",
            {"half": (half, "V, half of the zone"), "center": (center, "V")},
            (MAXIMUM, MINIMUM),
        )
        return StaticFilter(lambda u: u - np.minimum(np.maximum(u - center, -half), half), sampling.hold, code)


def parameters(around: Surroundings) -> tuple[Parameter, ...]:
    """Zone about 0, or about a point that is fitted, up to a quarter of the drive's range."""
    low, high = around.command
    reach = max(high - low, 1e-9)
    half = (0.01 * reach, *3 * (0.05 * reach,))
    starts = tuple(low + share * reach for share in (0.5, 0.5, 0.3, 0.7))
    return (
        Parameter("half_width", "command", 0.0, half, 0.0, 0.25 * reach, 0.03 * reach),
        # At an end of the range it would be an offset, or a limit.
        Parameter("center", "command", 0.0, starts, low + 0.1 * reach, high - 0.1 * reach, 0.1 * reach),
    )


EFFECT = Effect(
    "dead_zone",
    "drive",
    "The drive does not answer commands within a dead zone.",
    parameters,
    lambda values, around: DeadZone(values["half_width"], values.get("center", 0.0)),
    variants=lambda around: ({"center": 0.0}, {}) if around.command[0] < 0.0 < around.command[1] else ({},),
    exercised=lambda around: around.command[1] > around.command[0],
    phrase="a dead zone of ±{half_width} in the drive",
)
