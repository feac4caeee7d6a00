# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Smoothing of a command without phase: what is rough and white in it apart from what is smooth between steps and kinks.

Two estimators of a smooth signal in white noise compete, and the one with the lower risk is kept:

- a Wiener filter on the cosine transform, best for sines and whatever else fills few frequencies;
- a local parabola whose window grows to the left, to the right or to both sides until its estimates no longer agree (intersection of
  confidence intervals: Goldenshluger and Nemirovski 1997; Katkovnik 1999), which keeps steps and kinks.

The risk is Stein's unbiased estimate (1981): ‖c - ĉ‖² - N σ² + 2 σ² (degrees of freedom).
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from scipy.fft import dct, idct

from hyst_control.base.arrays import Array
from hyst_control.base.signals import convolved

WINDOWS = (4, 6, 8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256)  # Samples to one side of the parabola's windows
AGREEMENT = 1.5  # Standard deviations up to which estimates of two windows agree
OWN = 2.0  # Standard deviations up to which a sample itself agrees with a window; what is uniform is 1.7 off at most
NEIGHBORS = 40  # Most bins to either side over which the power of the cosine transform is averaged
NORMAL_MEDIAN = 0.6745  # Median of the absolute value of a standard normal variable


def white_part(values: Annotated[Array, "N"]) -> float:
    """Rms of the white part of a signal, from the median of its third differences, in which nothing that is smooth is left."""
    third = np.diff(values, 3)
    return float(np.median(np.abs(third - np.median(third))) / NORMAL_MEDIAN / np.sqrt(20.0)) if len(third) else 0.0


def smoothed(values: Annotated[Array, "N"]) -> Annotated[Array, "N"]:
    """Estimate the smooth part of a signal beside a white one."""
    sigma = white_part(values)
    found = [_by_frequency(values), _by_parabolas(values, sigma)]
    risks = [float(np.sum((values - smooth) ** 2) + 2.0 * sigma**2 * freedom) for smooth, freedom in found]
    return found[int(np.argmin(risks))][0]


def _by_frequency(values: Array) -> tuple[Array, float]:
    """Wiener filter on the cosine transform, and its degrees of freedom."""
    spectrum = dct(values, norm="ortho")
    power, bins = spectrum**2, np.arange(len(values))
    floor = float(np.median(power[len(power) // 2 :])) / NORMAL_MEDIAN**2
    reach = np.minimum(1 + bins // 10, NEIGHBORS)
    begin, end = np.maximum(bins - reach, 0), np.minimum(bins + reach + 1, len(bins))
    sums = np.concatenate([[0.0], np.cumsum(power)])
    around = (sums[end] - sums[begin]) / (end - begin)
    stands_out = around > floor * (1.0 + 3.0 * np.sqrt(2.0 / (end - begin)))
    gain = np.where(stands_out, 1.0 - floor / np.maximum(around, 1e-300), 0.0)
    gain[power > 2.2 * np.log(len(power)) * floor] = 1.0  # a line: noise is as large in one record of many
    return np.asarray(idct(gain * spectrum, norm="ortho"), dtype=np.float64), float(gain.sum())


def _by_parabolas(values: Array, sigma: float) -> tuple[Array, float]:
    """Local parabolas of the largest windows that agree, and their degrees of freedom."""
    sides = [_grown(values, sigma, left, right) for left, right in ((1, 0), (0, 1), (1, 1))]
    estimates, variances, weights = (np.array(rows) for rows in zip(*sides, strict=True))
    best = np.argmin(variances, axis=0)[None]
    value, variance = np.take_along_axis(estimates, best, 0), np.take_along_axis(variances, best, 0)
    # A side beyond a step disagrees with the best one, and is left out.
    precision = np.where(
        (estimates - value) ** 2 <= AGREEMENT**2 * (variances + variance), 1.0 / np.maximum(variances, 1e-300), 0.0
    )
    precision /= precision.sum(axis=0)
    return np.sum(precision * estimates, axis=0), float(np.sum(precision * weights))


def _grown(values: Array, sigma: float, left: int, right: int) -> tuple[Array, Array, Array]:
    """Value, variance and weight of the sample itself (N,) of parabolas whose windows reach to the left, the right or both."""
    rows = np.arange(len(values))
    value, variance, own = values.astype(float).copy(), np.full(len(values), sigma**2), np.ones(len(values))
    low, high = value - OWN * sigma, value + OWN * sigma
    growing = np.ones(len(values), dtype=bool)
    for window in WINDOWS:
        before, after = left * window, right * window
        if 4 * window >= len(values):
            break
        powers = np.vander(np.arange(-before, after + 1) / window, 3, increasing=True)
        weights = np.linalg.pinv(powers)[0]
        estimate = convolved(values, weights[::-1])[after : after + len(values)]
        deviation = sigma * float(np.sqrt(weights @ weights))
        low, high = np.maximum(low, estimate - AGREEMENT * deviation), np.minimum(high, estimate + AGREEMENT * deviation)
        growing = growing & (low <= high) & (rows >= before) & (rows < len(values) - after)
        value[growing], variance[growing], own[growing] = estimate[growing], deviation**2, weights[before]
    return value, variance, own
