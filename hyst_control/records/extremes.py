# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Min/max decimation of a table: every row that is kept is one of the record, and no peak of any column is lost."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array, Integers


class ExtremeRows:
    """Streaming selection of the rows at which a column has its least or its greatest value of a bin.

    Bins are `bin_ticks` ticks long and begin at multiples of that, so that the selection does not depend on how the table is cut into
    blocks. A bin of N rows and C columns leaves at most min(N, 2 C) rows; as whole rows are kept, values of one tick stay together.
    """

    def __init__(self, bin_ticks: int) -> None:
        if bin_ticks < 1:
            raise ValueError(f"bin_ticks: must be ≥ 1, got {bin_ticks}")
        self.bin_ticks = bin_ticks
        self.reset()

    def reset(self) -> None:
        """Forget the rows of the bin that is not complete."""
        self._ticks: Integers = np.zeros(0, np.int64)
        self._rows: Array = np.zeros((0, 0))

    def add(self, ticks: Integers, rows: Annotated[Array, "N C"]) -> tuple[Integers, Array]:
        """Take in rows; return those kept of the bins that are complete."""
        if len(self._ticks):
            ticks, rows = np.concatenate([self._ticks, ticks]), np.concatenate([self._rows, rows])
        if not len(ticks):
            return ticks, rows
        bins = ticks // self.bin_ticks
        last = bins[-1] + (ticks[-1] % self.bin_ticks == self.bin_ticks - 1)  # a bin is complete with its last tick, or a later one
        complete = int(np.searchsorted(bins, last))
        self._ticks, self._rows = ticks[complete:].copy(), rows[complete:].copy()
        if not complete:
            return ticks[:0], rows[:0]
        begins = np.flatnonzero(np.diff(bins[:complete], prepend=-1))
        kept = [begin + _extremes(part) for begin, part in zip(begins, np.split(rows[:complete], begins[1:]), strict=True)]
        chosen = np.concatenate(kept)
        return ticks[chosen], rows[chosen]


def _extremes(rows: Array) -> Integers:
    """Indices of the rows (N, C) with the least and the greatest value of a column, each once and in order."""
    unknown = np.isnan(rows)
    least = np.where(unknown, np.inf, rows).argmin(axis=0)
    greatest = np.where(unknown, -np.inf, rows).argmax(axis=0)
    return np.unique(np.concatenate([least, greatest]))
