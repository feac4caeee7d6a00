# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Repetition of rows: what a source keeps to send again, and when it does so."""

from __future__ import annotations

from collections import deque

import numpy as np

from hyst_control.base.arrays import Array

KEPT_ROWS, KEPT_BLOCKS = 4096, 8  # Rows and blocks of a signal that are kept at least
REPEAT_INTERVAL, LONGEST_INTERVAL = 0.02, 0.5
"""s, between two repetitions: twice as long after each that brought nothing, up to the longest."""


class RepetitionBackoff:
    """Times at which a row is repeated: less often, the longer nothing new has come."""

    def __init__(self, now: float, longest: float = LONGEST_INTERVAL) -> None:
        self.last = now  # Time in s of the last repetition, or of the last that was new if that came later
        self._interval, self._longest = REPEAT_INTERVAL, longest

    def progress(self, now: float) -> None:
        """Note that something new came at this time (s)."""
        self.last, self._interval = now, REPEAT_INTERVAL

    def due(self, now: float) -> bool:
        """True when a repetition is due at this time (s); it is then taken as done."""
        if now - self.last <= self._interval:
            return False
        self.last, self._interval = now, min(2.0 * self._interval, self._longest)
        return True


class Standstill:
    """Number of looks in a row at which nothing had changed."""

    def __init__(self) -> None:
        self.looks = 0
        self._state: object = self  # equal to no state

    def look(self, state: object) -> int:
        """Compare with the state at the last look; the number of looks since it changed, 0 when it did."""
        self.looks = self.looks + 1 if state == self._state else 0
        self._state = state
        return self.looks


class SentRows:
    """The newest successive rows of a signal that were sent: `KEPT_ROWS` and `KEPT_BLOCKS` blocks at least."""

    def __init__(self) -> None:
        self.end = 0  # Tick after the newest row
        self.count = 0  # Number of rows that are kept
        self._blocks: deque[Array] = deque()

    def add(self, tick: int, block: Array) -> None:
        """Keep a block (N, C) of rows from this tick on; those before are forgotten when it does not follow on them."""
        if tick != self.end:
            self.clear()
        self.end = tick + len(block)
        self._blocks.append(block)
        self.count += len(block)
        while self.count - len(self._blocks[0]) >= KEPT_ROWS and len(self._blocks) > KEPT_BLOCKS:
            self.count -= len(self._blocks.popleft())

    def since(self, tick: int) -> Array | None:
        """Rows (N, C) from this tick on, as far back as they are kept, or None when there are none."""
        blocks, start = [], self.end
        for block in reversed(self._blocks):
            if start <= tick:
                break
            blocks.append(block)
            start -= len(block)
        return np.concatenate(blocks[::-1])[max(tick - start, 0) :] if blocks else None

    @property
    def newest(self) -> Array | None:
        """The newest block (N, C), None when none is kept."""
        return self._blocks[-1] if self._blocks else None

    def clear(self) -> None:
        """Forget the rows that are kept."""
        self._blocks.clear()
        self.count = 0
