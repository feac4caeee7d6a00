# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Band of frequencies in which records tell something about the dynamics behind a hysteresis.

A pole far beyond what the command excites is not seen but made up: a lag of the hysteresis model at 50 Hz looks as well like a pole at
100 kHz. The band ends where the command's part of the motion beyond a frequency sinks into the noise, or becomes so small a share of the
motion that it is within the error of any hysteresis model.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.identify.solve.gram_sums import Window
from hyst_control.records.quantization_step import quantization_step

SEGMENT, SEGMENT_ROWS = 0.25, 64
"""Length (s), and least number of rows, of the segments that are looked at: a step among long loops is seen in its own."""
ABOVE_NOISE = 5.0  # Amplitude of the motion beyond a frequency, in amplitudes of the noise there
MIN_SHARE = 0.005  # The same as a share of the segment's whole motion: what hysteresis models leave is rarely less
QUIETEST = 0.05  # Share of the spectrum that is taken for noise alone
LOW_SHARE = 0.02  # Share of a command's power that lies below what counts as its lowest frequency
REACH = 6.0
"""Multiple of the band's end up to which a pole is fitted: a lag there still turns the phase at the end by 10 degrees, one further beyond
is not distinguished from a delay. Nor may a nearer bound stop the search on its way: at 3 the lag of the tour's record was lost, whose
final place is within the band."""


def excited_band(windows: Sequence[Window]) -> float:
    """Highest frequency that the command excites enough to tell the dynamics there."""
    slope = float(max(np.ptp(window.measurement) for window in windows) / max(np.ptp(window.command) for window in windows))
    return max(
        highest_above(slope * window.command, measurement_noise(window.measurement, window.sample_time), window.sample_time)
        for window in windows
    )


def highest_above(motion: Annotated[Array, "N"], noise: float | Annotated[Array, "N"], sample_time: float) -> float:
    """Highest frequency at which a motion is well above a noise, the rms of a white one or its samples."""
    size, taper = _segment(len(motion), sample_time)
    frequencies = np.fft.rfftfreq(size, sample_time)
    white = np.full(len(frequencies), np.square(noise) * np.sum(taper**2)) if np.ndim(noise) == 0 else None
    highest = 0.0
    for begin in _begins(len(motion), size):
        part = slice(begin, begin + size)
        quiet = _power(np.asarray(noise)[part], taper) if white is None else white
        beyond, beyond_noise = (np.cumsum(power[::-1])[::-1] for power in (_power(motion[part], taper), quiet))
        told = (beyond > ABOVE_NOISE**2 * beyond_noise) & (beyond > MIN_SHARE**2 * beyond[0])
        if beyond[0] > 0.0 and np.any(told):
            highest = max(highest, float(frequencies[np.flatnonzero(told)[-1]]))
    return highest


def lowest_frequency(commands: Sequence[Array], sample_time: float) -> float:
    """Lowest frequency of commands: the share `LOW_SHARE` of their power lies below it."""
    found = []
    for command in commands:
        columns = command.reshape(len(command), -1)
        rows = (columns - columns.mean(axis=0)) * np.hanning(len(columns))[:, None]
        power = np.sum(np.abs(np.fft.rfft(rows, axis=0)) ** 2, axis=1)
        share = np.cumsum(power) / max(float(power.sum()), 1e-300)
        lowest = max(int(np.argmax(share >= LOW_SHARE)), 1)
        found.append(lowest / (len(rows) * sample_time))
    return min(found)


def measurement_noise(values: Annotated[Array, "N"], sample_time: float) -> float:
    """White noise of a measurement: the level that its spectrum nowhere falls below, but at least that of its rounding."""
    size, taper = _segment(len(values), sample_time)
    power = np.mean([_power(values[begin : begin + size], taper) for begin in _begins(len(values), size)], axis=0)
    level = float(np.quantile(power[1:], QUIETEST)) / float(np.sum(taper**2))
    return max(float(np.sqrt(level)), quantization_step(values) / float(np.sqrt(12.0)))


def _segment(rows: int, sample_time: float) -> tuple[int, Array]:
    """Rows of a segment, and its window."""
    size = min(max(int(SEGMENT / sample_time), SEGMENT_ROWS), rows)
    return size, np.hanning(size)


def _begins(rows: int, size: int) -> range:
    return range(0, rows - size + 1, max(size // 2, 1))


def _power(values: Array, taper: Array) -> Array:
    power: Array = np.abs(np.fft.rfft(taper * (values - np.mean(values)))) ** 2
    return power
