"""Distribution of durations in fixed memory, however long the run."""

from __future__ import annotations

import math

import numpy as np

SHORTEST, LONGEST = 1e-7, 1e3
"""s; shorter and longer durations are counted as these."""
RESOLUTION = 0.01
"""Relative width of a bin."""


class Durations:
    """Histogram of durations (s) with logarithmic bins of 1 %."""

    def __init__(self) -> None:
        self._offset = math.log(SHORTEST)
        self._counts = [0] * (int((math.log(LONGEST) - self._offset) / RESOLUTION) + 2)  # numpy's items would cost a tick more

    def add(self, seconds: float) -> None:
        """Count one duration.

        Parameters
        ----------
        seconds : float
            The duration in s.
        """
        self._counts[int((math.log(min(max(seconds, SHORTEST), LONGEST)) - self._offset) / RESOLUTION)] += 1

    @property
    def count(self) -> int:
        """Number of counted durations."""
        return sum(self._counts)

    def quantile(self, share: float) -> float:
        """Quantile of the durations, to 1 %.

        Parameters
        ----------
        share : float
            Share of the durations that do not exceed it, 0 to 1.

        Returns
        -------
        float
            The quantile in s; NaN before the first duration.
        """
        total = self.count
        if not total:
            return math.nan
        at = int(np.searchsorted(np.cumsum(self._counts), max(share * total, 1)))
        return math.exp(self._offset + (at + 0.5) * RESOLUTION)

    def entries(self, name: str) -> dict[str, str]:
        """Median, 99 % and 99.9 % quantiles as entries of the diagnostics.

        Parameters
        ----------
        name : str
            Beginning of the keys.

        Returns
        -------
        dict of str
            Quantiles in us, by key; empty before the first duration.
        """
        return {
            f"{name} {label} [us]": f"{self.quantile(share) * 1e6:.1f}"
            for label, share in (("p50", 0.5), ("p99", 0.99), ("p99.9", 0.999))
            if self.count
        }
