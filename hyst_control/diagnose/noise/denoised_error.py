# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Removal of the noise from a baseline residual, by the quietest part of its spectrum, before it is subtracted from another record."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array, Complex
from hyst_control.records.session_zero import without_zero

NOISE_REACH = 20
"""Bins of the spectrum to either side over which the power of a carried error is averaged to tell its noise."""


def without_noise(error: Annotated[Array, "N A"], most: Array | float = np.inf) -> tuple[Array, Array]:
    """Take the white noise off a carried error, frequency by frequency as far as it is noise (Wiener filter); noise (A,) that is left.

    The noise of the baseline records is not that of the new one. Carried along, it would be noise that a low-pass at the sensor removes.
    """
    # most: noise that it has at most, rms, where periods of the command tell; infinite otherwise. A model's error may be as rough
    # as noise
    rest, _ = without_zero(error)
    spectrum, smooth, floor = _floor_of(rest)
    floor = np.minimum(floor, 2 * len(rest) * most**2)
    kept = np.clip(1.0 - floor / np.maximum(smooth, 1e-300), 0.0, 1.0)
    smoothed = np.fft.irfft(kept * spectrum, 2 * len(rest), axis=0)[: len(rest)]
    # Near the lines of a periodic command all of it is left.
    left = np.sqrt(np.mean(kept**2, axis=0) * floor / (2 * len(rest)))
    return np.asarray(error - rest + smoothed, dtype=np.float64), left


def white_noise(rows: Annotated[Array, "N A"]) -> Annotated[Array, "A"]:
    """Estimate the white part of rows from the quietest bins of the upper half of their spectrum."""
    if len(rows) <= 2 * NOISE_REACH:
        return np.full(rows.shape[1], np.inf)
    return np.asarray(np.sqrt(_floor_of(without_zero(rows)[0])[2] / (2 * len(rows))), dtype=np.float64)


def _floor_of(rest: Array) -> tuple[Complex, Array, Array]:
    """Spectrum (F, A) of rows and their mirror image, its smoothed power, and the power (A,) of its quietest bins above the middle."""
    spectrum = np.fft.rfft(np.concatenate([rest, rest[::-1]]), axis=0)
    power = np.abs(spectrum) ** 2
    window = np.ones(2 * NOISE_REACH + 1) / (2 * NOISE_REACH + 1)
    smooth = np.stack([np.convolve(np.pad(column, NOISE_REACH, mode="reflect"), window, "valid") for column in power.T], axis=1)
    quiet = np.asarray(np.quantile(smooth[len(smooth) // 2 :], 0.2, axis=0), dtype=np.float64)
    return np.asarray(spectrum, dtype=np.complex128), smooth, quiet
