# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Steps of a reference that are greater than the slew limit allows."""

from __future__ import annotations

from hyst_control.base.arrays import Array


class SlopeDemand:
    """The first step of a signal that is greater than a limit allows."""

    def __init__(self, before: Array | None = None) -> None:
        self._before: list[float] | None = None if before is None else before.tolist()
        self._tick = -1
        self._found = False

    def exceeds(self, first: int, rows: Array, step: float) -> tuple[int, float] | None:
        """Tick and slope (V a tick), once, of the first row (N, A) from tick `first` on that rises by more than `step` V a tick."""
        if self._found or not step:
            return None
        for tick, row in enumerate(rows.tolist(), first):
            if tick <= self._tick:
                continue
            way = max(map(abs, map(float.__sub__, row, self._before))) if self._before is not None else 0.0
            slope, self._before, self._tick = way / (tick - self._tick), row, tick
            if slope > step * (1.0 + 1e-9):
                self._found = True
                return tick, slope
        return None
