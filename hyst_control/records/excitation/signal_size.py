# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers of a signal's description, and how many samples a signal may have: checked before any of them is made."""

from __future__ import annotations

import os
from functools import cache
from numbers import Real
from typing import Any

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError

COPIES = 8  # Times that a signal stands in memory while it is built
LONGEST = 500_000_000  # Samples; a longer signal would not fit in memory


@cache
def max_samples() -> float:
    """Samples of all axes that this machine's memory holds, with the copies that are made of them."""
    try:
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (ValueError, OSError, AttributeError):
        return LONGEST
    return min(LONGEST, memory / COPIES / 8)


def number(value: Any, name: str) -> float:
    """`value` as a number, or an InputError that names the parameter where it is none."""
    try:
        found = float(value) if isinstance(value, Real) and not isinstance(value, bool) else np.nan
    except OverflowError:  # a whole number of hundreds of digits
        found = np.nan
    if np.isnan(found):
        raise InputError(f"{name}: must be a number, got {value!r}")
    return found


def is_shown(frequency: float, sample_time: float) -> bool:
    """True for a frequency below half the sample rate; any other would appear as one that is."""
    return bool(abs(frequency) < (1.0 - 1e-9) * 0.5 / sample_time)


def check_size(samples: float) -> None:
    """Refuse what does not fit in memory before any of it is made."""
    if not samples <= max_samples():
        raise InputError(f"{samples:.3g} samples do not fit in memory: shorten it, or lower the rate")


def sample_count(duration: float, sample_time: float) -> int:
    """Samples of a signal of this length, at least one; an InputError where there is none or they do not fit in memory."""
    count = int(round(number(duration, "duration") / sample_time))
    if count > max_samples():
        raise InputError(f"duration: {duration:g} s at {sample_time:g} s a sample is too long for memory")
    if count < 1:
        raise InputError(f"duration: {duration:g} s is shorter than a sample of {sample_time:g} s")
    return count


def sample_times(duration: float, sample_time: float) -> Array:
    """Times of a signal's samples (N,), s, from 0."""
    return np.arange(sample_count(duration, sample_time), dtype=np.float64) * sample_time
