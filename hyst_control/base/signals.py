# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Convolution, spectrum and low-passes of whole signals, without `scipy.signal`, whose import takes half a second."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numba import njit
from scipy.fft import dct, idct, irfft, next_fast_len, rfft

from hyst_control.base.arrays import Array


def convolved(one: Annotated[Array, "N"], other: Annotated[Array, "M"]) -> Annotated[Array, "N + M - 1"]:
    """Convolve two signals."""
    length = len(one) + len(other) - 1
    size = next_fast_len(length, real=True)
    return np.asarray(irfft(rfft(one, size) * rfft(other, size), size)[:length], dtype=np.float64)


def correlated(one: Annotated[Array, "N"], other: Annotated[Array, "M"]) -> Annotated[Array, "N + M - 1"]:
    """Sums of products of two signals, from the shift 1 - M of the second one to N - 1."""
    return convolved(one, other[::-1])


def periodogram(rows: Annotated[Array, "N ..."], rate: float, linear: bool = False) -> tuple[Array, Array]:
    """Frequencies (Hz) and one-sided density of rows without their mean, or their straight line, in a Hann window."""
    count = len(rows)
    trend = np.vander(np.linspace(-1.0, 1.0, count), 2 if linear else 1)
    flat = rows.reshape(count, -1)
    flat = flat - trend @ np.linalg.lstsq(trend, flat, rcond=None)[0]
    window = np.hanning(count + 1)[:-1, None]
    power = np.abs(rfft(flat * window, axis=0)) ** 2 / (rate * np.sum(window**2))
    power[1 : None if count % 2 else -1] *= 2.0
    frequency = np.asarray(np.fft.rfftfreq(count, 1.0 / rate), dtype=np.float64)
    return frequency, np.asarray(power.reshape(-1, *rows.shape[1:]), dtype=np.float64)


def averaged_periodogram(
    values: Annotated[Array, "N"], rate: float, length: int, centered: bool = True
) -> tuple[Annotated[Array, "F"], Annotated[Array, "F"]]:
    """Frequencies (Hz) and one-sided density of a signal by Welch's method: Hann windows of a length, each half over the one before."""
    segments = np.lib.stride_tricks.sliding_window_view(values, length)[:: length - length // 2]
    if centered:
        segments = segments - segments.mean(axis=1, keepdims=True)
    window = np.hanning(length + 1)[:-1]
    power = np.mean(np.abs(rfft(segments * window)) ** 2, axis=0) / (rate * np.sum(window**2))
    power[1 : None if length % 2 else -1] *= 2.0
    return np.asarray(np.fft.rfftfreq(length, 1.0 / rate), dtype=np.float64), np.asarray(power, dtype=np.float64)


def low_passed(rows: Annotated[Array, "N ..."], corner: float) -> Annotated[Array, "N ..."]:
    """Rows after a Butterworth low-pass of second order forward and backward, its corner in half the sample rate."""
    frequency = np.arange(len(rows)) / len(rows)
    gain = 1.0 / (1.0 + (np.tan(0.5 * np.pi * frequency) / np.tan(0.5 * np.pi * corner)) ** 4)
    spectrum = dct(rows, norm="ortho", axis=0) * gain.reshape(-1, *(1,) * (rows.ndim - 1))
    return np.asarray(idct(spectrum, norm="ortho", axis=0), dtype=np.float64)


@njit(cache=True, error_model="numpy")
def lagging(signal: Annotated[Array, "N"], keep: float, before: float, now: float) -> Annotated[Array, "N"]:
    """A signal that begins at rest behind a lag: keep times its last output, and shares of the input before and now."""
    found = np.empty_like(signal)
    value, last = signal[0], signal[0]
    for k in range(len(signal)):
        value = keep * value + now * signal[k] + before * last
        last = signal[k]
        found[k] = value
    return found
