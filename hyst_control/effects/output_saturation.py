# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A motion or sensor that ends at one side: an end stop, an overflow, the end of a sensor's range."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hyst_control.chain.memoryless import Saturation
from hyst_control.chain.stage import register
from hyst_control.effects.effect import Effect
from hyst_control.effects.saturation import limits


@register
@dataclass(frozen=True)
class OutputSaturation(Saturation):
    """y = min(max(u, lower), upper) of what is measured; an infinite limit is none. `knee` as of `saturation`."""

    name: ClassVar[str] = "output_saturation"
    place: ClassVar[str] = "sensor"


EFFECT = Effect(
    "output_saturation",
    "sensor",
    "What is measured ends at one side: an end stop, an overflow, or the end of the sensor's range.",
    lambda around: limits("unit", *around.measurement, 0.02, False),  # beyond the range as far as noise carries
    lambda values, around: OutputSaturation(values["lower"], values["upper"], values.get("knee", 0.0)),
    variants=lambda around: tuple(
        {absent: limit, **knee} for knee in ({"knee": 0.0}, {}) for absent, limit in (("lower", -np.inf), ("upper", np.inf))
    ),
    exercised=lambda around: around.stroke > 0,
    repeats_values=True,
    phrase="a saturation of the output at one side",
)
