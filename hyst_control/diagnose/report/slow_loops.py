# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Slow loops of a record: rows of whole command cycles in which dynamics play no part and hysteresis is seen best."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.identify.data.reversal_points import turning_points

MIN_HEIGHT = 0.3  # Least height of a loop, in the command's range


def slow_loops(command: Annotated[Array, "N"], most: int = 2) -> list[slice]:
    """Find the slowest loops of a command: up and down again, or down and up; steps are the fastest."""
    turns = np.append(_large_turns(command, MIN_HEIGHT * float(np.ptp(command))), len(command) - 1)
    speed = np.abs(np.diff(command, append=command[-1]))
    found = [
        (float(speed[begin:end].max() / np.ptp(command[begin : end + 1])), int(begin), int(end))
        for begin, middle, end in zip(turns[:-2], turns[1:-1], turns[2:], strict=True)
        if min(abs(command[middle] - command[begin]), abs(command[middle] - command[end])) >= MIN_HEIGHT * np.ptp(command)
    ]
    kept: list[tuple[int, int]] = []
    for _, begin, end in sorted(found):
        if all(end <= other_begin or begin >= other_end for other_begin, other_end in kept):
            kept.append((begin, end))
        if len(kept) == most:
            break
    return [slice(begin, end + 1) for begin, end in sorted(kept)] or [slice(0, len(command))]


def _large_turns(command: Array, height: float) -> Array:
    """Turning points between which the command moves by at least a height: small wiggles do not count."""
    kept: list[int] = [0]
    for point in turning_points(command)[1:]:
        rising = len(kept) < 2 or command[kept[-1]] > command[kept[-2]]
        if len(kept) > 1 and (command[point] - command[kept[-1]]) * (1 if rising else -1) > 0:
            kept[-1] = int(point)  # further in the same direction
        elif abs(command[point] - command[kept[-1]]) >= height:
            kept.append(int(point))
    return np.array(kept)
