# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Limits that whoever drives an actuator keeps on its own side, whatever it receives."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array

MANY_AXES = 64  # Axes from which on a look at the array is cheaper than one at each


@dataclass(frozen=True)
class CommandLimits:
    """Range and slope of the voltage on an actuator."""

    # lower, upper: Range, V
    lower: float = -math.inf
    upper: float = math.inf
    step: float = math.inf  # Greatest change from one tick to the next, V

    def limited(self, command: Annotated[Array, "A"], applied: Annotated[Array, "A"]) -> Annotated[Array, "A"]:
        """Command within the limits."""
        if self._holds(command) and not math.isfinite(self.step):
            return command
        within = np.clip(command, self.lower, self.upper)
        return np.clip(within, applied - self.step, applied + self.step) if math.isfinite(self.step) else within

    def _holds(self, command: Array) -> bool:
        """True where a command (A,) is within the range on all axes, which a NaN is not."""
        if len(command) > MANY_AXES:
            return bool(self.lower <= command.min() and command.max() <= self.upper)
        return all(self.lower <= value <= self.upper for value in command.tolist())
