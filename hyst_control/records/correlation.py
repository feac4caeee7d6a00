"""Correlation of a residual along its record."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def correlation_length(rows: Array) -> float:
    """Number of samples per independent one: the integral of the autocorrelation over the lags before it first falls to 0.

    The integrated autocorrelation time of Geyer (Statistical Science 7, 1992), truncated at the first zero.

    Parameters
    ----------
    rows : ndarray, shape (N, A)
        A residual, any unit.

    Returns
    -------
    float
        Samples, at least 1; the largest of the axes'.

    """
    lengths = []
    for column in rows.T:
        centered = column - column.mean()
        spectrum = np.abs(np.fft.rfft(centered, 2 * len(centered))) ** 2
        correlation = np.fft.irfft(spectrum)[: len(centered)]
        if correlation[0] <= 0:
            continue
        correlation /= correlation[0]
        first = int(np.argmax(correlation <= 0)) or len(correlation)
        lengths.append(1.0 + 2.0 * float(correlation[1:first].sum()))
    return max([1.0, *lengths])
