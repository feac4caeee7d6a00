# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Long records of slow motions at a lower rate, at which a search of structures sees them from end to end.

Each command is the mean of those held during the longer interval, which moves a plant slower than that alike; each measurement
the mean around its instant.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.identify.data.excited_band import measurement_noise
from hyst_control.identify.solve.gram_sums import Window
from hyst_control.records.stream.row_store import spread_parts

SEGMENT, FEWEST, LOOKED_AT = 4096, 64, 2**20
"""Rows of the segments whose spectra are looked at, lines beyond a frequency that separate motion from noise, and rows looked at."""
MOVES = 2.0  # Ratio of a segment's power beyond a frequency to that of the noise there, from which it moves
RATE = 20.0  # Least sample rate, in highest frequencies of the motion


def thinning(windows: Sequence[Window], rows: int) -> int:
    """Number of samples whose mean is one row, so that the records fit into so many rows; fewer where their motion is too fast for it."""
    total = sum(len(window.command) for window in windows)
    if total <= rows or any(window.memory is not None for window in windows):
        return 1
    return max(min(-(-total // rows), int(1.0 / (RATE * max(map(highest_motion, windows))))), 1)


def highest_motion(window: Window) -> float:
    """Highest frequency (cycles a sample) at which a measurement moves beyond its noise."""
    size = min(SEGMENT, len(window.measurement))
    taper, highest = np.hanning(size), 1.0 / size
    parts = [window.measurement[part] for part in spread_parts(len(window.measurement), LOOKED_AT)]
    noise = min(measurement_noise(part, window.sample_time) for part in parts) ** 2 * float(np.sum(taper**2))
    for part in parts:
        for begin in range(0, len(part) - size + 1, size // 2):
            values = part[begin : begin + size]
            power = np.abs(np.fft.rfft(taper * (values - np.linspace(values[0], values[-1], size)))) ** 2
            beyond = np.cumsum(power[::-1])[::-1]
            moves = beyond > MOVES * noise * np.arange(len(power), 0, -1)
            highest = max(highest, float(np.flatnonzero(moves[:-FEWEST])[-1]) / size if np.any(moves[:-FEWEST]) else 0.0)
    return highest


def thinned(window: Window, count: int) -> Window:
    """A window at a lower rate."""
    if count == 1:
        return window
    rows = (len(window.command) - 1) // count
    measured = _around(window.measurement, count)[: rows * count : count]
    held = window.command[: rows * count].reshape(rows, count).mean(axis=1)
    command = held if window.hold == "zoh" else _around(window.command, count)[: rows * count : count]
    skip = -(-window.skip // count)
    return replace(window, command=command, measurement=measured, sample_time=window.sample_time * count, skip=skip)


def _around(values: Array, count: int) -> Array:
    """Means of as many values around each one, of an odd number of them."""
    half = count // 2
    sums = np.cumsum(np.concatenate([np.zeros(1), values - values[0]]))
    rows = np.arange(len(values))
    low, high = np.maximum(rows - half, 0), np.minimum(rows + half + 1, len(values))
    near = np.minimum(rows - low, high - 1 - rows)  # as many before as behind, also at the ends
    means: Array = (sums[rows + near + 1] - sums[rows - near]) / (2 * near + 1) + values[0]
    return means
