# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Distribution of durations in fixed memory, however long the run."""

from __future__ import annotations

import math
from array import array
from collections.abc import Sequence

import numpy as np

SHORTEST, LONGEST = 1e-7, 1e3  # s; shorter and longer durations are counted as these
RESOLUTION = 0.01  # Relative width of a bin


class Durations:
    """Histogram of durations (s) with logarithmic bins of 1 %."""

    def __init__(self) -> None:
        self._offset = math.log(SHORTEST)
        bins = int((math.log(LONGEST) - self._offset) / RESOLUTION) + 2
        self._counts = array("q", bytes(8 * bins))  # numpy's items would cost a tick more

    def add(self, seconds: float) -> None:
        """Count one duration."""
        self._counts[int((math.log(min(max(seconds, SHORTEST), LONGEST)) - self._offset) / RESOLUTION)] += 1

    @property
    def count(self) -> int:
        """Number of counted durations."""
        return sum(self._counts)

    def quantile(self, share: float) -> float:
        """Quantile of the durations, to 1 %."""
        return self._quantiles([share])[0]

    def _quantiles(self, shares: Sequence[float]) -> list[float]:
        below = np.frombuffer(self._counts, np.int64).cumsum()
        if not below[-1]:
            return [math.nan] * len(shares)
        at = below.searchsorted([max(share * below[-1], 1) for share in shares])
        return [math.exp(self._offset + (place + 0.5) * RESOLUTION) for place in at]

    def entries(self, name: str) -> dict[str, str]:
        """Median, 99 % and 99.9 % quantiles as entries of the diagnostics."""
        labels = {"p50": 0.5, "p99": 0.99, "p99.9": 0.999}
        found = self._quantiles(list(labels.values()))
        return {f"{name} {label} [us]": f"{each * 1e6:.1f}" for label, each in zip(labels, found, strict=True) if each == each}
