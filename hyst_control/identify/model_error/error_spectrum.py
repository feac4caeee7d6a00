# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Spectrum of the model discrepancy: how large it is at each frequency, and the filter that makes it white.

A model's error on baseline records is hardly ever white: creep and memory are slow, a gain that is a little off stands at the command's own
frequencies. A single number for its size hides what is fast beside what is slow. Residuals are therefore multiplied, in the discrete
cosine transform of each record, by

    g(f) = σ / sqrt(S(f) + max(σ, ν)²),    S: power density of the own error, σ, ν: white noise of the record, and of the clean ones,

so that the own error and the noise together become white noise of size 1 (generalized least squares). Lines of a baseline record keep their
height: S is the upper envelope of its periodogram, for what a model leaves at a frequency of the command is one number, not many.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from hashlib import sha256
from typing import Annotated

import numpy as np
from scipy.fft import dct, idct
from scipy.ndimage import maximum_filter1d, uniform_filter1d

from hyst_control.base.arrays import Array

OCTAVES = 1.0 / 3.0  # Octaves to either side over which the largest bin counts: another command's lines are elsewhere
FUNDAMENTALS = 1.0
"""The same in slowest excited frequencies, at most: a line far above the command, such as mains hum, is no error of the model."""
SMOOTHED = 3  # Bins that are averaged before: a line between two bins has its power in both
MUCH_MORE = 4.0
"""Factor of the output's power (twice its amplitude) beyond which the baseline records say nothing of the model at a frequency."""
MAX_MORE = 100.0  # Largest factor by which more power of the output raises that of the error
UPPER = 0.6  # Share of the Nyquist frequency above which the median bin is the white noise's
MEDIAN = 0.4549  # Median of a squared normal variable


@dataclass(frozen=True, eq=False)
class ErrorSpectrum:
    """Power density of the model discrepancy beyond the white noise."""

    frequencies: Annotated[Array, "F"]  # Ascending, Hz
    power: Annotated[Array, "F A"]  # Expected square of an orthonormal cosine coefficient, measurement unit squared
    # White noise of the baseline records, rms, measurement unit: what takes it off at high frequencies leaves it at low ones
    noise: Annotated[Array, "A"]

    @classmethod
    def of(cls, errors: Sequence[Array], sample_time: float, rows: int, slowest: float, factor: float = 1.0) -> ErrorSpectrum:
        """Estimate the spectrum from errors on baseline records."""
        nyquist = 0.5 / sample_time
        frequencies = nyquist * np.arange(rows) / rows
        power, noise = np.zeros((rows, errors[0].shape[1])), np.zeros(errors[0].shape[1])
        for error in errors:
            own, white = _envelope(error, nyquist, slowest, max(rows / len(error), 1.0))
            noise += white / len(errors)
            at = nyquist * np.arange(len(error)) / len(error)
            power += factor / len(errors) * np.stack([np.interp(frequencies, at, column) for column in own.T], axis=1)
        return cls(frequencies, power, np.sqrt(noise))

    def with_further(self, other: ErrorSpectrum) -> ErrorSpectrum:
        """Add an error that has nothing to do with this one, at the same frequencies."""
        return ErrorSpectrum(self.frequencies, self.power + other.power, np.maximum(self.noise, other.noise))

    def with_slow_part(self, known: ErrorSpectrum, excited: Annotated[Array, "F A"]) -> ErrorSpectrum:
        """Replace the slow part by that of fewer rows, up to where this spectrum first falls below the white noise.

        Lines far above the command are those of this spectrum, since more rows show them better. And what the fewer rows do not excite
        tells no error of the model.
        """
        slow = np.cumsum(self.power < self.noise**2, axis=0) == 0
        # What lies below the noise in the fewer rows may be as large as that.
        most = (known.power + self.noise**2) * np.maximum(excited, 1.0) - self.noise**2
        lower = np.minimum(self.power, most)
        return ErrorSpectrum(self.frequencies, np.where(slow, lower, self.power), self.noise)

    def for_output(self, known: ErrorSpectrum, new: ErrorSpectrum, relative: Annotated[Array, "A"]) -> ErrorSpectrum:
        """Predict the error on new records, whose commands drive some frequencies more than those of the baseline ones did.

        A model that leaves a share of its output at a frequency leaves that share of more output too; where the baseline records' commands
        drive next to nothing, they say nothing of the model, and its error is taken to be the usual share of its output.
        """
        more = np.minimum(new.power / np.maximum(known.power, 1e-300), MAX_MORE)
        foreseen = more * self.power
        beyond = relative**2 * np.maximum(new.power - MUCH_MORE * known.power, 0.0)
        return ErrorSpectrum(self.frequencies, np.maximum(self.power, np.maximum(foreseen, beyond)), self.noise)

    def rms(self, sigma: Annotated[Array, "A"]) -> Annotated[Array, "A"]:
        """Size of model discrepancy and noise together."""
        return np.asarray(np.sqrt(np.mean(self.power, axis=0) + np.maximum(sigma, self.noise) ** 2), dtype=np.float64)

    def gain(self, rows: int, sigma: Annotated[Array, "A"], sample_time: float) -> Annotated[Array, "N A"]:
        """Factors of the cosine coefficients that make model discrepancy and noise white."""
        at = 0.5 / sample_time * np.arange(rows) / rows
        power = np.stack([np.interp(at, self.frequencies, column) for column in self.power.T], axis=1)
        return np.asarray(sigma / np.sqrt(power + np.maximum(sigma, self.noise) ** 2), dtype=np.float64)

    def digest(self) -> str:
        """SHA-256, by which caches tell spectra apart."""
        return sha256(np.ascontiguousarray(self.power).tobytes() + np.asarray(self.noise).tobytes()).hexdigest()


def _envelope(error: Array, nyquist: float, slowest: float, longer: float) -> tuple[Array, Array]:
    """Power (N, A) of an error beyond its white noise, the largest of the bins around, and this noise's power (A,).

    longer: factor of the power of lines.
    """
    power = dct(error, type=2, norm="ortho", axis=0) ** 2
    count = len(power)
    noise = np.median(power[int(UPPER * count) :], axis=0) / MEDIAN
    smooth, broad = uniform_filter1d(power, SMOOTHED, axis=0), np.empty_like(power)
    found, bins = np.empty_like(power), np.arange(count)
    octave = np.maximum((2.0**OCTAVES - 1.0) * bins, 1.0)
    most = max(FUNDAMENTALS * slowest / nyquist * count, 1.0)
    reach = np.minimum(octave, most)
    # Few different reaches, powers of two, each a filter of the bins that have it and of those around.
    steps = np.ceil(np.log2(reach))
    for step in np.unique(steps):
        half, (begin, end) = int(2.0**step), np.searchsorted(steps, [step, step + 0.5])
        around, here = slice(max(begin - half, 0), end + half), slice(min(begin, half), min(begin, half) + end - begin)
        width = 2 * half + 1
        chance = 1.0 + (np.log(width) + 1.0) / (0.5 * SMOOTHED)  # the largest of so many bins of white noise
        found[begin:end] = (maximum_filter1d(smooth[around], width, axis=0) - chance * noise)[here]
        broad[begin:end] = (uniform_filter1d(power[around], width, axis=0) - noise)[here]
    return np.asarray(np.maximum(np.maximum(longer * found, broad), 0.0), dtype=np.float64), noise


def filtered(rows: Annotated[Array, "N A"], gain: Annotated[Array, "N A"]) -> Annotated[Array, "N A"]:
    """Multiply the cosine coefficients of a record."""
    return np.asarray(idct(gain * dct(rows, type=2, norm="ortho", axis=0), type=2, norm="ortho", axis=0), dtype=np.float64)
