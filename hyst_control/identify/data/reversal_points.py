# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Turning points of a command: all that rate-independent hysteresis remembers."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numba import njit

from hyst_control.base.arrays import Array, Integers
from hyst_control.records.stream.row_store import blocks


def turning_points(command: Annotated[Array, "N"]) -> Array:
    """Find the samples at which a signal turns; play operators remember no others."""
    turns, way = [np.zeros(1, dtype=int)], 0.0
    for part in blocks(len(command)):
        slope = np.sign(np.diff(command[part.start : part.stop + 1]))
        moving = np.flatnonzero(slope)
        if not len(moving):
            continue
        ways = slope[moving]
        before = np.concatenate([[way or ways[0]], ways[:-1]])
        turns.append(moving[ways != before] + part.start)
        way = float(ways[-1])
    return np.concatenate(turns)


@njit(cache=True)
def surviving_turns(values: Array) -> Integers:
    """Find the turning points that no later excursion has passed: Madelung's rules remember no others."""
    kept = np.empty(values.size, dtype=np.int64)
    count = 0
    for k in range(values.size):
        if count >= 2 and (values[k] - values[kept[count - 1]]) * (values[kept[count - 1]] - values[kept[count - 2]]) >= 0.0:
            count -= 1
        kept[count] = k
        count += 1
        # The pair before the last point is wiped out when the last one lies past its beginning.
        while count >= 4 and (values[k] - values[kept[count - 3]]) * (values[k] - values[kept[count - 2]]) >= 0.0:
            count -= 2
            kept[count - 1] = k
    return kept[:count]
