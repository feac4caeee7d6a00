# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The one entry of rows that come from other programs: times that are ticks, values that are finite and in range, blocks of sane size.

Whatever listens to a topic asks here before it computes with a message. What is refused is dropped and counted under its kind.
"""

from __future__ import annotations

import math
from typing import Annotated, NamedTuple

import numpy as np

from hyst_control.base.arrays import Array, Mask
from hyst_control.records.stream.signal_rows import first_tick, tick_at

LARGEST_VALUE = 1e12
"""V, um or mrad: no drive and no sensor comes near it, and sums and products of such values with any gain stay finite."""

MAX_ROWS = 1_000_000  # Rows of one message; the longest block that a node may be set to

NOT_FINITE, OUT_OF_RANGE, OFF_THE_CLOCK, TOO_LONG = "not finite", "out of range", "off the clock", "too long"


class Refusal(NamedTuple):
    """Kind of fault, under which it is counted, and the reason in words."""

    kind: str
    reason: str


MANY_VALUES = 64  # Values from which on a look at the array is cheaper than one at each of them


def admit(block: Annotated[Array, "N 1 + A"], period: float) -> int | Refusal:
    """Check the rows of a message."""
    rows = len(block)
    if rows > MAX_ROWS:
        return Refusal(TOO_LONG, f"it has {rows} rows, at most {MAX_ROWS} are taken")
    if block.size > MANY_VALUES:
        if not (-LARGEST_VALUE <= block.min() and block.max() <= LARGEST_VALUE):  # neither is a NaN
            return refused_values(block)
    else:
        for value in block.ravel().tolist():  # rather than all(…): once per message of a running loop
            if not -LARGEST_VALUE <= value <= LARGEST_VALUE:
                return refused_values(block)
    tick = tick_at(block.item(0), period) if rows == 1 else first_tick(block, period)
    return Refusal(OFF_THE_CLOCK, off_the_clock(period)) if tick is None else tick


def admissible(block: Array) -> Mask:
    """Mask (N,) of the rows of a `block` (N, C) whose values are finite and in range."""
    mask: Mask = np.logical_and.reduce(np.abs(block) <= LARGEST_VALUE, axis=1)
    return mask


def refused_values(block: Array) -> Refusal:
    """Reason for refusing the values of a `block` (N, C)."""
    if not all(map(math.isfinite, block.ravel().tolist())):
        return Refusal(NOT_FINITE, "it contains NaN or infinity")
    return Refusal(OUT_OF_RANGE, f"it contains a number beyond {LARGEST_VALUE:g}")


def off_the_clock(period: float) -> str:
    """Reason for refusing a message whose times are not ticks."""
    return f"its times are not successive multiples of the period {period:g} s: is rate_hz the same everywhere?"
