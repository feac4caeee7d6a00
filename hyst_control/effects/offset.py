# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A zero other than the model's."""

from __future__ import annotations

from hyst_control.chain.memoryless import Offset
from hyst_control.effects.effect import Companion, Effect, Parameter

EFFECT = Effect(
    "offset",
    "sensor",
    "The sensor's zero is off.",
    lambda around: (
        Parameter("offset", "unit", 0.0, (0.01 * around.stroke,), -0.5 * around.stroke, 0.5 * around.stroke, 0.05 * around.stroke),
    ),
    lambda values, around: Offset(values["offset"]),
    companion=Companion(0, "offset"),
    phrase="an offset of {offset}",
)
