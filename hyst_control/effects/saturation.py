# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A driver that clips."""

from __future__ import annotations

import numpy as np

from hyst_control.chain.memoryless import Saturation
from hyst_control.effects.effect import Effect, Parameter


def limits(unit: str, low: float, high: float, beyond: float, together: bool) -> tuple[Parameter, ...]:
    """Limits within a range and `beyond` it by a share, at once or over a knee; `together`: fits begin with one inside, or both."""
    reach = max(high - low, 1e-9)
    # One limit may lie anywhere, as a loop drives the command far beyond it: the prior is as high as a uniform one over the range.
    inside, most, beyond, scale = 0.1 * reach, 0.9 * reach, beyond * reach, reach / np.sqrt(2.0 * np.pi)
    starts = (
        ((low, high - inside), (low, low + 0.3 * reach), (low + inside, high), (low + inside, high - inside))
        if together
        else ((low, high), (low + inside, high - inside))
    )
    lower, upper = zip(*starts, strict=True)
    return (
        Parameter("lower", unit, -np.inf, lower, low - beyond, low + most, scale, smooth=0.002 * reach),
        Parameter("upper", unit, np.inf, upper, high - most, high + beyond, scale, smooth=0.002 * reach),
        Parameter("knee", unit, 0.0, (0.02 * reach,), 0.002 * reach, 0.2 * reach, 1.0, True, told=False),
    )


EFFECT = Effect(
    "saturation",
    "drive",
    "The driver clips the command.",
    lambda around: limits("command", *around.command, 1e-3, True),  # at the end of the range that is driven a limit does nothing
    lambda values, around: Saturation(values["lower"], values["upper"], values.get("knee", 0.0)),
    variants=lambda around: ({"knee": 0.0}, {}),
    exercised=lambda around: around.command[1] > around.command[0],
    phrase="saturation of the drive",
)
