# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Frequency of a motion at each of its samples, from one turning point to the next."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array

LEAST_SWING = 0.02  # Of the range: a smaller swing is noise or a quantization step, and no turning point


def motion_frequency(signal: Annotated[Array, "N"], sample_time: float) -> Annotated[Array, "N"]:
    """Frequency (N,), Hz, whose half period is the way between two turning points; NaN where there are fewer than two."""
    from scipy.signal import find_peaks

    swing = LEAST_SWING * max(float(np.ptp(signal)), 1e-300)
    turns = np.sort(np.concatenate([find_peaks(sign * signal, prominence=swing)[0] for sign in (1.0, -1.0)]))
    if len(turns) < 2:
        return np.full(len(signal), np.nan)
    between = 0.5 / (np.diff(turns) * sample_time)
    return np.asarray(between[np.clip(np.searchsorted(turns, np.arange(len(signal)), side="right") - 1, 0, len(between) - 1)])
