# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Correlation of a residual along its record."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.records.stream.row_store import blocks, mean_square, spread_parts

LONGEST, PARTS = 2**20, 16
"""Samples up to which the whole autocorrelation is computed; stretches into which so many of a longer record are divided."""


def correlation_length(rows: Annotated[Array, "N A"]) -> float:
    """Number of samples per independent one: the integral of the autocorrelation over the lags before it first falls to 0."""
    # The integrated autocorrelation time of Geyer (Statistical Science 7, 1992), truncated at the first zero. Of records beyond `LONGEST`
    # samples, a zero within the lags of `PARTS` stretches is found from these; where there is none, the integral is that of the means of
    # neighboring samples, whose spectrum at frequency 0 is the samples' own.
    return max([1.0, *(_long_length(values) if len(values) > LONGEST else _length(values) for values in rows.T)])


def matching_length(rows: Annotated[Array, "N A"]) -> float:
    """Number of samples per independent one where two signals like these are correlated with each other."""
    # The sum of the squared autocorrelation over all lags (Bartlett, Supplement to the Journal of the Royal Statistical Society 8, 1946): a
    # sine never forgets its phase, so that a record of one has two independent samples, however long it is. Of records beyond `LONGEST`
    # samples the first ones count.
    longest = 1.0
    for values in rows[:LONGEST].T:
        products = _products(values - values.mean())
        if products[0] > 0:
            left = 1.0 - np.arange(len(values)) / len(values)
            longest = max(longest, 2.0 * float(np.sum((products / products[0]) ** 2 / left)) - 1.0)
    return longest


def _length(values: Array) -> float:
    """Samples per independent one of few `values` (N,); 0 where they do not vary."""
    products = _products(values - values.mean())
    return _integral(products) if products[0] > 0 else 0.0


def _long_length(values: Array) -> float:
    """Samples per independent one of many `values` (N,); 0 where they do not vary."""
    mean = float(values.mean())
    variance = mean_square(values, mean)
    if variance <= 0:
        return 0.0
    stretches = [values[part] - mean for part in spread_parts(len(values), LONGEST, PARTS)]
    # Half of a stretch's lags: of the others too few products are known.
    near = np.sum([_products(each) for each in stretches], axis=0)[: len(stretches[0]) // 2]
    near /= len(stretches) * np.arange(len(stretches[0]), len(stretches[0]) - len(near), -1)
    if near[0] > 0 and np.any(near <= 0):
        return _integral(near)
    together = -(-len(values) // LONGEST)
    count = len(values) // together
    means = np.empty(count)
    for part in blocks(count):
        means[part] = values[part.start * together : part.stop * together].reshape(-1, together).mean(axis=1) - mean
    products = _products(means) / count
    first = int(np.argmax(products <= 0)) or count
    return together * float(products[0] + 2.0 * products[1:first].sum()) / variance


def _products(centered: Array) -> Array:
    """Sums (N,) of the products of values (N,) and those so many samples behind them."""
    spectrum = np.abs(np.fft.rfft(centered, 2 * len(centered))) ** 2
    return np.asarray(np.fft.irfft(spectrum)[: len(centered)], dtype=np.float64)


def _integral(products: Array) -> float:
    """Integral of a correlation, given up to a factor, over both signs of the lag before it first falls to 0."""
    correlation = products / products[0]
    first = int(np.argmax(correlation <= 0)) or len(correlation)
    return 1.0 + 2.0 * float(correlation[1:first].sum())
