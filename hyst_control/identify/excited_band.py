"""Band of frequencies in which records tell something about the dynamics behind a hysteresis.

A pole far beyond what the command excites is not seen but made up: a lag of the hysteresis model at 50 Hz looks as well like a pole at
100 kHz. The band ends where the command's part of the motion beyond a frequency sinks into the noise, or becomes so small a share of the
motion that it is within the error of any hysteresis model.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hyst_control.chain.stage import Array
from hyst_control.identify.gram_sums import Window
from hyst_control.records.quantization_step import quantization_step

SEGMENT = 0.25
"""Length (s) of the segments that are looked at: a step among long loops is seen in its own."""
ABOVE_NOISE = 5.0
"""Amplitude of the motion beyond a frequency, in amplitudes of the noise there."""
LEAST_SHARE = 0.005
"""The same as a share of the segment's whole motion: what hysteresis models leave is rarely less."""
REACH = 3.0
"""A mode at this multiple of the band's end raises the amplitude there by a ninth, one further beyond is not distinguished from a delay."""


def excited_band(windows: Sequence[Window]) -> float:
    """Highest frequency that the command excites enough to tell the dynamics there.

    Parameters
    ----------
    windows
        Records of one axis.

    Returns
    -------
    float
        Hz.
    """
    slope = max(np.ptp(window.measurement) for window in windows) / max(np.ptp(window.command) for window in windows)
    return max(_band(window, float(slope)) for window in windows)


def measurement_noise(values: Array) -> float:
    """White noise of a measurement from its third differences, at least that of its rounding.

    Parameters
    ----------
    values
        Measurement (N,).

    Returns
    -------
    float
        rms, in the measurement's unit.
    """
    if len(values) < 8:
        return 0.0
    noise = float(np.median(np.abs(np.diff(values, 3)))) / 0.6745 / np.sqrt(20.0)
    return max(noise, quantization_step(values) / np.sqrt(12.0))


def _band(window: Window, slope: float) -> float:
    n = len(window.command)
    size = min(max(int(SEGMENT / window.sample_time), 16), n)
    taper = np.hanning(size)
    noise = measurement_noise(window.measurement) ** 2 * float(np.sum(taper**2))
    frequencies = np.fft.rfftfreq(size, window.sample_time)
    highest = 0.0
    for begin in range(0, n - size + 1, max(size // 2, 1)):
        moving = window.command[begin : begin + size]
        spectrum = np.abs(np.fft.rfft(taper * (moving - np.mean(moving)))) ** 2
        beyond = np.cumsum(spectrum[::-1])[::-1] * 2.0 / size * slope**2
        share = np.linspace(1.0, 1.0 / len(frequencies), len(frequencies))
        told = (beyond > ABOVE_NOISE**2 * noise * share) & (beyond > LEAST_SHARE**2 * beyond[0])
        if beyond[0] > 0.0 and np.any(told):
            highest = max(highest, float(frequencies[np.flatnonzero(told)[-1]]))
    return highest
