# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Removal of the noise from a baseline residual, by the quietest part of its spectrum, before it is subtracted from another record."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from scipy.special import chdtri

from hyst_control.base.arrays import Array, Complex
from hyst_control.records.session_zero import without_zero

NOISE_REACH = 20
"""Bins of the spectrum to either side over which the power of a carried error is averaged to tell its noise."""

QUIET = 0.2  # Share of the averaged bins that count as the quietest
BELOW = float(chdtri(2 * NOISE_REACH + 1, 1.0 - QUIET)) / (2 * NOISE_REACH + 1)
"""That quantile of averaged bins of white noise, in its power: bins of rows and their mirror image have one degree of freedom each."""


def without_noise(error: Annotated[Array, "N A"], most: Array | float = np.inf) -> tuple[Array, Array]:
    """Take the white noise off a carried error, frequency by frequency as far as it is noise (Wiener filter); noise that is left.

    The noise of the baseline records is not that of the new one. Carried along, it would be noise that a low-pass at the sensor removes.
    Of what is left (N, A) only its size and spectrum are known: it is drawn.
    """
    # most: noise that it has at most, rms, where periods of the command tell; infinite otherwise. A model's error may be as rough
    # as noise
    rest, _ = without_zero(error)
    spectrum, smooth, floor = _floor_of(rest)
    floor = np.minimum(floor, 2 * len(rest) * most**2)
    smoothed = _kept(smooth, floor) * spectrum
    # Drawn noise goes the way of the true one: of both the filter keeps most where they happen to be large.
    noise = _spectrum(np.random.default_rng(0).standard_normal(rest.shape) * np.sqrt(floor / (2 * len(rest))))
    left = _kept(_smooth(smoothed + noise), floor) * noise

    def rows(bins: Complex) -> Array:
        return np.asarray(np.fft.irfft(bins, 2 * len(rest), axis=0)[: len(rest)], dtype=np.float64)

    return np.asarray(error - rest + rows(smoothed), dtype=np.float64), rows(left)


def _kept(smooth: Array, floor: Array) -> Array:
    """Share of every bin that is no noise."""
    return np.clip(1.0 - floor / np.maximum(smooth, 1e-300), 0.0, 1.0)


def white_noise(rows: Annotated[Array, "N A"]) -> Annotated[Array, "A"]:
    """Estimate the white part of rows from the quietest bins of the upper half of their spectrum."""
    if len(rows) <= 2 * NOISE_REACH:
        return np.full(rows.shape[1], np.inf)
    return np.asarray(np.sqrt(_floor_of(without_zero(rows)[0])[2] / (2 * len(rows))), dtype=np.float64)


def _floor_of(rest: Array) -> tuple[Complex, Array, Array]:
    """Spectrum (F, A) of rows and their mirror image, its smoothed power, and the power (A,) of its quietest bins above the middle."""
    spectrum = _spectrum(rest)
    smooth = _smooth(spectrum)
    quiet = np.quantile(smooth[len(smooth) // 2 :], QUIET, axis=0) / BELOW
    return spectrum, smooth, np.asarray(quiet, dtype=np.float64)


def _spectrum(rest: Array) -> Complex:
    return np.asarray(np.fft.rfft(np.concatenate([rest, rest[::-1]]), axis=0), dtype=np.complex128)


def _smooth(spectrum: Complex) -> Array:
    """Power of every bin, averaged over its neighbors."""
    window = np.ones(2 * NOISE_REACH + 1) / (2 * NOISE_REACH + 1)
    padded = np.pad(np.abs(spectrum) ** 2, ((NOISE_REACH, NOISE_REACH), (0, 0)), mode="reflect")
    return np.stack([np.convolve(column, window, "valid") for column in padded.T], axis=1)
