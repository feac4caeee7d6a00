# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A driver that clips."""

from __future__ import annotations

import numpy as np

from hyst_control.chain.memoryless import Saturation
from hyst_control.effects.effect import Effect, Parameter, Surroundings


def parameters(around: Surroundings) -> tuple[Parameter, ...]:
    """Limits inside the record's range of command: at its end a limit does nothing. They set in at once or over a knee."""
    low, high = around.command
    reach = max(high - low, 1e-9)
    inside, most, beyond = 0.1 * reach, 0.45 * reach, 1e-3 * reach
    return (
        Parameter("lower", "V", -np.inf, (low, low + inside, low + inside), low - beyond, low + most, inside),
        Parameter("upper", "V", np.inf, (high - inside, high, high - inside), high - most, high + beyond, inside),
        Parameter("knee", "V", 0.0, (0.02 * reach,), 0.002 * reach, 0.2 * reach, 1.0, True, told=False),
    )


EFFECT = Effect(
    "saturation",
    "drive",
    "The driver clips the command.",
    parameters,
    lambda values, around: Saturation(values["lower"], values["upper"], values.get("knee", 0.0)),
    variants=lambda around: ({"knee": 0.0}, {}),
    exercised=lambda around: around.command[1] > around.command[0],
    phrase="saturation of the drive",
)
