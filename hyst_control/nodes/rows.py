"""Rows of one signal by tick: in order and each once, whatever the transport repeats, loses or cuts."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

NEW, DUPLICATE, GAP, FULL = "new", "duplicate", "gap", "full"


class Rows:
    """Rows that have arrived and have not been used yet.

    contiguous: a block that would leave a gap is refused (lockstep: it will be sent again); otherwise the gap is kept
    (timer: a tick was missed). most: while so many rows wait, new ones are refused: a signal that nobody uses, because
    another one stands still, must not fill the memory. `end` is the tick after the newest row, or None before the first one.
    """

    def __init__(self, contiguous: bool, most: int) -> None:
        self.contiguous, self.most = contiguous, most
        self.clear()

    def clear(self) -> None:
        """Forget everything: the next block may start anywhere."""
        self.end: int | None = None
        self.available = 0
        self._blocks: deque[tuple[int, Array]] = deque()

    @property
    def start(self) -> int | None:
        """Tick of the oldest unused row; the next one expected when there is none; None before the first one."""
        return self._blocks[0][0] if self._blocks else self.end

    def append(self, tick: int, block: Array) -> str:
        """Take in rows (N, A) of ticks tick, tick + 1, …; what was there already is dropped. NEW, DUPLICATE, GAP or FULL."""
        rows = len(block)
        if self.end is not None and tick != self.end:
            if tick + rows <= self.end:
                return DUPLICATE
            if tick > self.end:
                if self.contiguous:
                    return GAP
            else:
                block = block[self.end - tick :]
                tick, rows = self.end, len(block)
        if self.available >= self.most:
            return FULL
        if rows:
            self._blocks.append((tick, block))
            self.end = tick + rows
            self.available += rows
        return NEW

    def take(self, count: int) -> Array:
        """The oldest `count` rows (count, A); gaps are not visible in them."""
        first, block = self._blocks[0]
        if len(block) == count:
            self._blocks.popleft()
            self.available -= count
            return block
        parts, missing = [], count
        while missing:
            first, block = self._blocks.popleft()
            if len(block) > missing:
                self._blocks.appendleft((first + missing, block[missing:]))
                block = block[:missing]
            parts.append(block)
            missing -= len(block)
        self.available -= count
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def skip_to(self, tick: int) -> None:
        """Drop the rows before this tick."""
        while self._blocks and self._blocks[0][0] < tick:
            first, block = self._blocks.popleft()
            self.available -= min(len(block), tick - first)
            if first + len(block) > tick:
                self._blocks.appendleft((tick, block[tick - first :]))

    def newest(self, tick: int) -> Array | None:
        """The newest row (A,) not later than this tick, or None; older ones are dropped, it stays."""
        while len(self._blocks) > 1 and self._blocks[1][0] <= tick:
            self.available -= len(self._blocks.popleft()[1])
        if not self._blocks or self._blocks[0][0] > tick:
            return None
        first, block = self._blocks[0]
        return block[min(tick - first, len(block) - 1)]
