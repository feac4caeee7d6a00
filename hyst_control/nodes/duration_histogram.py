"""Distributions of durations, kept in a fixed room whatever the length of the run."""

from __future__ import annotations

import math

import numpy as np

SHORTEST, LONGEST = 1e-7, 1e3
"""s; shorter and longer durations count as these."""
RESOLUTION = 0.01
"""Width of a class, relative."""


class Durations:
    """A histogram of durations (s) with logarithmic classes of 1 %."""

    def __init__(self) -> None:
        self._offset = math.log(SHORTEST)
        self._counts = np.zeros(int((math.log(LONGEST) - self._offset) / RESOLUTION) + 2, dtype=np.int64)

    def add(self, seconds: float) -> None:
        """Count one duration."""
        self._counts[int((math.log(min(max(seconds, SHORTEST), LONGEST)) - self._offset) / RESOLUTION)] += 1

    @property
    def count(self) -> int:
        """Number of durations that were counted."""
        return int(self._counts.sum())

    def quantile(self, share: float) -> float:
        """The duration (s) that this share of all did not exceed, to 1 %; NaN before the first one."""
        total = self.count
        if not total:
            return math.nan
        at = int(np.searchsorted(np.cumsum(self._counts), max(share * total, 1)))
        return math.exp(self._offset + (at + 0.5) * RESOLUTION)

    def entries(self, name: str) -> dict[str, str]:
        """Median, 99 and 99.9 % in us, as entries of the diagnostics."""
        return {
            f"{name} {label} [us]": f"{self.quantile(share) * 1e6:.1f}"
            for label, share in (("p50", 0.5), ("p99", 0.99), ("p99.9", 0.999))
            if self.count
        }
