# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Likelihood of a residual by octaves, each with a scale that is known as well as its error is.

A residual is taken to the orthonormal cosine transform of each record, where noise and model discrepancy are independent from
frequency to frequency. In octave b, n coefficients of variance V_b have a scale of an inverse-gamma prior of ν_b degrees of freedom:

    log p(r) = Σ_b  log Γ((ν+n)/2) - log Γ(ν/2) - n/2 log(ν/2) - n/2 log V - (ν+n)/2 log(1 + E/ν),    E_b = Σ r² / V_b

For ν → ∞, where noise dominates, this is the Gaussian. An octave whose error is a model's counts as few independent coefficients.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct
from scipy.special import gammaln

from hyst_control.base.arrays import Array
from hyst_control.diagnose.problem.problem import Problem
from hyst_control.identify.model_error.error_spectrum import ErrorSpectrum

FIRST = 4  # Cosine coefficients of the slowest octave
CHANCE = 2.0  # Standard deviations that the mean square of an octave may exceed its variance by chance


def cosine(problem: Problem, flat: Array) -> Array:
    """Orthonormal cosine coefficients of flat vectors (M,) or (M, K), record by record and axis by axis."""
    axes, columns = len(problem.model.axes), flat.shape[1:]
    parts = np.split(flat.reshape(len(flat) // axes, axes, *columns), problem.edges)
    if not flat.size:
        return flat
    return np.concatenate([dct(part, norm="ortho", axis=0).reshape(-1, *columns) for part in parts])


@dataclass(frozen=True)
class Octaves:
    """Octaves of a problem's cosine coefficients, and how well the variance of each is known."""

    index: NDArray[np.intp]  # Octave of each coefficient
    own: Array  # By octave, share of the model's discrepancy in the variance before any effect
    freedom: Array  # Degrees of freedom of that discrepancy's scale
    white: float  # Degrees of freedom of the noise's scale
    weight: Array  # By octave, independent values per coefficient, at most 1
    per_axis: int  # Octaves of an axis; those of further axes follow

    @cached_property
    def sizes(self) -> Array:
        """Number of coefficients by octave."""
        return np.bincount(self.index, minlength=len(self.own)).astype(float)

    def energies(self, coefficients: Array) -> Array:
        """Sum of squares by octave."""
        return np.bincount(self.index, coefficients**2, minlength=len(self.own)).astype(np.float64)

    def weighted(self, excess: Array, values: float) -> Octaves:
        """The same octaves, of which those with a model's error count as `values` independent coefficients.

        excess: by octave, mean square that the best explanation leaves, in variances. What it leaves beyond the variance is an error
        of some model too.
        """
        beyond = excess - CHANCE * np.sqrt(2.0 / np.maximum(self.sizes, 1.0))
        shares = np.maximum(self.own, 1.0 - 1.0 / np.maximum(beyond, 1.0))
        return replace(self, weight=1.0 / (1.0 + shares * np.maximum(self.sizes / values - 1.0, 0.0)))

    def degrees(self, variance: Array, stage: float) -> Array:
        """Degrees of freedom of the scale of each octave, whose variance beyond 1 is an effect's error, known by `stage` degrees."""
        own, added = self.own / variance, 1.0 - 1.0 / variance
        noise = np.maximum(1.0 - own - added, 0.0)
        return 1.0 / np.maximum(own**2 / self.freedom + added**2 / stage + noise**2 / self.white, 1e-12)

    def log_density(self, energies: Array, variance: Array, freedom: Array) -> float:
        """Log density of coefficients of these energies, without the constant of their number."""
        n = self.weight * self.sizes
        e = self.weight * energies / variance
        terms = gammaln(0.5 * (freedom + n)) - gammaln(0.5 * freedom) - 0.5 * n * np.log(0.5 * freedom)
        return float(np.sum(terms - 0.5 * n * np.log(variance) - 0.5 * (freedom + n) * np.log1p(e / freedom)))

    def precision(self, energies: Array, variance: Array, freedom: Array) -> Array:
        """Weights of the squares by octave with which least squares has the slope of the log density."""
        n, e = self.weight * self.sizes, self.weight * energies / variance
        return np.asarray(self.weight * (freedom + n) / (freedom + e) / variance, dtype=np.float64)


def octaves_of(problem: Problem, freedom: float) -> Octaves:
    """Octaves of a problem, the discrepancy's scale in each known by `freedom` degrees where its spectrum is used."""
    counts, axes = problem.counts, len(problem.model.axes)
    longest = max(counts)
    number = int(np.ceil(np.log2(longest / FIRST))) + 2
    index, own = [], []
    for count in counts:
        bins = np.arange(count) * (longest / count)
        octave = np.maximum(np.floor(np.log2(bins / FIRST + 1e-9)).astype(int) + 1, 0)
        index.append((octave[:, None] + number * np.arange(axes)).reshape(-1))
        own.append(_own_shares(problem, count).reshape(-1))
    flat = np.concatenate(index)
    sizes = np.maximum(np.bincount(flat, minlength=number * axes), 1)
    shares = np.bincount(flat, np.concatenate(own), minlength=number * axes) / sizes
    # The noise's scale was estimated from about half of the coefficients.
    return Octaves(flat, shares, np.full(number * axes, freedom), 0.5 * float(longest), np.ones(number * axes), number)


def _own_shares(problem: Problem, count: int) -> Array:
    """Share (N, A) of the model's discrepancy in the variance of whitened coefficients, and of rounding, which follows the signal too."""
    steps = np.array(problem.steps) if problem.steps else np.zeros(len(problem.model.axes))
    rounding = np.minimum(steps**2 / 12.0 / problem.sigma**2, 1.0)
    if not isinstance(problem.own_spectrum, ErrorSpectrum):
        return np.tile(rounding, (count, 1))
    gain = problem.own_spectrum.gain(count, problem.sigma, problem.sample_time)
    noise = np.maximum(problem.sigma, problem.own_spectrum.noise) / problem.sigma
    return np.asarray(1.0 - (gain * noise) ** 2 * (1.0 - rounding), dtype=np.float64)
