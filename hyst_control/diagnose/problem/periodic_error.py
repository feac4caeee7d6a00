# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Model discrepancy beside a periodic command: it comes back with every period, so that what periods differ by is not of its making.

The mean over the periods is as uncertain as the stated discrepancy makes it, and the rest is noise, or a gain that drifts.
"""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import sha256
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array


@dataclass(frozen=True)
class PeriodicError:
    """Model discrepancy that comes back with every period, of records whose rows that count are one stretch."""

    periods: tuple[int | None, ...]  # Rows of a period, by record; None: not periodic, all of it may be discrepancy
    weight: float  # Of a sample of what comes back, as `Problem.weight` has it
    own_error: Annotated[Array, "A"]  # Rms of the discrepancy, measurement unit

    def whitened(self, index: int, rows: Annotated[Array, "N A"], inverse: bool = False) -> Annotated[Array, "N A"]:
        """Rows of a record with what comes back reduced to units of the discrepancy; inverse: back to units of the noise."""
        factor = self.weight ** (-0.5 if inverse else 0.5)
        return np.asarray(factor * rows + (1.0 - factor) * self.between(index, rows), dtype=np.float64)

    def between(self, index: int, rows: Annotated[Array, "N A"]) -> Annotated[Array, "N A"]:
        """Differences of the last whole periods of a record from their mean; 0 before, where the first one fills the memory."""
        found, period = np.zeros_like(rows), self.periods[index]
        if period is not None:
            count = (len(rows) // period - 1) * period
            whole = rows[-count:].reshape(-1, period, rows.shape[1])
            found[-count:] = (whole - whole.mean(axis=0)).reshape(count, -1)
        return found

    def rms(self, sigma: Annotated[Array, "A"]) -> Annotated[Array, "A"]:
        """Size of model discrepancy and noise together."""
        return np.asarray(np.hypot(self.own_error, sigma), dtype=np.float64)

    def digest(self) -> str:
        """SHA-256, by which caches tell errors apart."""
        return sha256(repr((self.periods, f"{self.weight:.1g}")).encode()).hexdigest()
