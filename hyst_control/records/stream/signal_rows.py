# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Rows of one signal in time: every tick once and in order, whatever the transport reorders, loses, repeats or cuts.

One state machine for all receivers. It knows no transport, and the time is given to it. A source numbers its rows by ticks 0, 1, 2, …
and may send any of them again, cut into other blocks. A receiver offers every block to `SignalRows.receive` and takes the rows that
can be used. What becomes of rows before which others are missing is the receiver's choice:

=========  ===================================================  ==============================================================
`Missing`  rows behind a gap                                    the first rows that are heard
=========  ===================================================  ==============================================================
`REFUSE`   refused (`GAP`): their source sends them again       refused (`JOINING`) unless they are those of tick 0 or a repetition
`HOLD`     kept (`HELD`) until the gap is filled or given up    kept, and used once none is waited for before them: these are lost
`SKIP`     taken: the missing ones are lost                     taken
=========  ===================================================  ==============================================================

Who is discovered while rows are being sent hears the later ones only, and would go on without those before. So as long as somebody
lacks rows the run stands still, and all are sent again: a receiver that lacks none sees them as duplicates and is told by
`repetition_due` to repeat what it made of them.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from enum import Enum
from typing import Annotated, NamedTuple

import numpy as np

from hyst_control.base.arrays import Array, Integers
from hyst_control.records.stream.row_repetition import RepetitionBackoff

CLOCK_TOLERANCE = 1e-3  # Ticks by which the time of a row may differ from a multiple of the period
LONGEST_JOINING = 2.0
"""s, for which a newly heard signal is waited to be repeated: of a run that goes on nothing is repeated."""
GAP_PATIENCE = 5.0
"""s, for which rows that are missing are waited for with `HOLD`: the plant repeats what it sent long before that."""
MAX_GAPS = 1024  # Gaps that are remembered, to know their rows when they come late
MAX_REPLACED = 3  # Ticks in a row that come with two values, from which on these are two sources
MAX_TICK = 2**53  # Largest tick: beyond it the time of a row, a double, cannot tell one tick from the next


class Missing(Enum):
    """Rule for rows before which others are missing; see the module."""

    REFUSE = "refuse"
    HOLD = "hold"
    SKIP = "skip"


class Receipt(Enum):
    """Answer to a block of rows."""

    ACCEPTED = "accepted"  # Rows that are new in it can be taken, or will be once the signal has joined
    DUPLICATE = "duplicate"  # All its ticks were there before
    CONFLICT = "conflict"  # All its ticks were there before, with other values
    REPLACED = "replaced"  # All its ticks were there before, with other values, which are replaced
    LATE = "late"  # Its ticks were given up as lost
    GAP = "gap"  # Refused: rows before it are missing
    HELD = "held"  # Kept: rows before it are missing
    JOINING = "joining"  # Refused: the signal is heard from the middle of a run on, and may be sent again
    FULL = "full"  # Refused: as many rows as may wait are waiting to be taken
    AHEAD = "ahead"  # Refused: more than `max_queued_rows` lie between it and the row that is due; rows that continue it are taken
    CLOCK_RESET = "clock reset"  # Refused: its time lies far before that of rows that were there; `forget` takes the new time


class Wait(NamedTuple):
    """A signal that is waited for: the tick that is due, and for how long (s) no row of it has come."""

    topic: str
    tick: int
    seconds: float

    def __str__(self) -> str:
        return f"{self.topic}@{self.tick} ({self.seconds:.1f} s)"


class SignalRows:
    """Rows of one signal that have been received, and those that can be taken."""

    def __init__(
        self,
        missing: Missing,
        max_queued_rows: int,
        now: float,
        period: float = 1.0,
        clock_reset_threshold: Callable[[], float] = lambda: math.inf,
        drop_oldest: bool = False,
        replace: bool = False,
        may_leap: Callable[[int], bool] = lambda end: False,
    ) -> None:
        self._may_leap = may_leap
        self.missing, self.max_queued_rows, self.drop_oldest, self.replace = missing, max_queued_rows, drop_oldest, replace
        self.arrived = now
        self.missed = self.dropped = 0
        self._period, self._clock_reset_threshold = period, clock_reset_threshold
        self._backoff = RepetitionBackoff(now)
        self._repeated_from: int | None = None  # oldest tick that came again since new rows came or a repetition
        self.forget()

    def forget(self) -> None:
        """Begin anew: the next rows may have any tick."""
        self.end: int | None = None
        self.available = 0
        self.joined = False
        self.conflicted = -math.inf
        self._replaced_end = self._replaced_in_a_row = 0  # tick after the last one that was replaced, and how many before it were
        self.gaps: deque[tuple[int, int]] = deque(maxlen=MAX_GAPS)
        self._blocks: deque[tuple[int, Array]] = deque()
        self._newest: tuple[int, Array] | None = None  # rows that came last, and the tick of the first of them
        self._held: dict[int, Array] = {}  # rows behind a gap, by the tick of the first of them
        self.held = 0  # number of rows behind a gap
        self._gap_since = 0.0
        self._first_heard: int | None = None
        self._joining_since = 0.0
        self._leap_end: int | None = None  # tick after rows that were refused because they lie far ahead

    def expect(self, tick: int) -> None:
        """Forget what waits: the next row is that of this tick, wherever the signal begins."""
        self._blocks.clear()
        self.available = 0
        self.end, self.joined = tick, True

    @property
    def start(self) -> int:
        """Tick of the oldest row that waits, or of the one that is due next when there is none."""
        return self._blocks[0][0] if self._blocks else self.awaited

    @property
    def awaited(self) -> int:
        """Tick of the row that is due next."""
        return self.end if self.end is not None and self.joined else 0

    def receive(self, tick: int, rows: Annotated[Array, "N A"], now: float) -> Receipt:
        """Take in a block."""
        if not self.joined and not self._join(tick, now):
            return Receipt.JOINING
        first, new, end = tick, rows, self.end
        if tick != end and end is not None:
            if tick + len(rows) <= end:
                return self._receive_again(tick, rows, now)
            if tick < end:
                first, new = end, rows[end - tick :]
            elif self.missing is Missing.REFUSE:
                return Receipt.GAP
            elif tick - end > self.max_queued_rows and tick != self._leap_end and not self._may_leap(tick + len(rows)):
                self._leap_end = tick + len(rows)  # a single one may come from anybody
                return Receipt.AHEAD
            elif self.missing is Missing.HOLD:
                self._hold(tick, rows, now)
                return Receipt.HELD
        if self.available >= self.max_queued_rows and not self.drop_oldest:
            if self.missing is not Missing.HOLD or self.joined:
                return Receipt.FULL
            self._begin()
        self._append(first, new)
        self._newest = tick, rows
        self.arrived = now
        self._repeated_from = None
        return Receipt.ACCEPTED

    def repetition_due(self, now: float) -> int | None:
        """Tick from which on what followed from the rows is to be repeated, or None; to be asked when rows have come again."""
        # Not while new rows come, since what goes on lacks nothing; and of two sources of one signal, which bring every tick twice,
        # each repetition would cause others. So the longer repetitions have brought nothing, the rarer they are.
        if self.arrived > self._backoff.last:
            self._backoff.progress(self.arrived)
        if self._repeated_from is None or not self._backoff.due(now):
            return None
        oldest, self._repeated_from = self._repeated_from, None
        return oldest

    def release(self, now: float, give_up: bool = False) -> None:
        """Move rows behind gaps into the queue once these are filled or were waited for long enough, and with `give_up` in any case.

        What may come before the first rows is waited for in the same way: of a run that is over nothing comes any more.
        """
        if self._blocks and (give_up or now - self._joining_since > LONGEST_JOINING):
            self._begin()
        if self._held:
            self._release(now, give_up or now - self._gap_since > GAP_PATIENCE)

    def take(self, count: int) -> Array:
        """The oldest `count` rows (count, A); gaps are not visible in them."""
        first, block = self._blocks[0]
        if len(block) == count:
            self._blocks.popleft()
            self.available -= count
            return block
        parts, needed = [], count
        while needed:
            first, block = self._blocks.popleft()
            if len(block) > needed:
                self._blocks.appendleft((first + needed, block[needed:]))
                block = block[:needed]
            parts.append(block)
            needed -= len(block)
        self.available -= count
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def take_blocks(self) -> list[tuple[int, Array]]:
        """All rows that can be taken, as blocks (N, A) of successive ticks with the tick of the first row; none before it has joined."""
        if not self.joined:
            return []
        blocks = list(self._blocks)
        self._blocks.clear()
        self.available = 0
        return blocks

    def take_before(self, tick: int) -> tuple[Integers, Array]:
        """Ticks (N,) and rows (N, A) of all rows before this tick; (0,) and (0, 0) when there is none."""
        ticks, parts = [], []
        while self._blocks and self._blocks[0][0] < tick:
            first, block = self._blocks.popleft()
            if first + len(block) > tick:
                self._blocks.appendleft((tick, block[tick - first :]))
                block = block[: tick - first]
            ticks.append(np.arange(first, first + len(block)))
            parts.append(block)
            self.available -= len(block)
        if not parts:
            return np.zeros(0, np.int64), np.zeros((0, 0))
        return np.concatenate(ticks), np.concatenate(parts)

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
        newest: Array = block[min(tick - first, len(block) - 1)]
        return newest

    def behind(self, tick: int) -> int:
        """Ticks from the newest row that is due at this tick to the tick; 0 when no row is known yet."""
        if self._blocks and self._blocks[0][0] <= tick:
            first, block = self._blocks[-1] if self._blocks[-1][0] <= tick else self._blocks[0]
            return max(tick - (first + len(block) - 1), 0)
        return max(tick - self.end + 1, 0) if self.end is not None and not self._blocks else 0

    def _join(self, tick: int, now: float) -> bool:
        """Judge rows that come while it is not known whether the first ones are heard; False when they are refused."""
        if self.missing is Missing.SKIP:
            self.joined = True
            return True
        if self._first_heard is None:
            self._first_heard, self._joining_since = tick, now
            first = tick == 0
        else:
            first = tick <= self._first_heard or now - self._joining_since > LONGEST_JOINING
        if self.missing is Missing.HOLD:
            if self.end is None or tick < self._first_heard:  # a repetition: what was heard stands behind it
                heard = list(self._blocks)
                self.expect(tick)
                for first_of_block, block in heard:
                    self._hold(first_of_block, block, now)
            self.joined = False
            if first:
                self._begin()
            return True
        self.joined = first
        return first

    def _begin(self) -> None:
        """Join with the rows held so far: of those before them none is waited for any more."""
        if self.joined:
            return
        self.joined = True
        first = self._blocks[0][0] if self._blocks else self.end
        if first:
            self.missed += first
            self.gaps.append((0, first))

    def _receive_again(self, tick: int, rows: Array, now: float) -> Receipt:
        """Judge rows of ticks that were there: a repetition, late ones, a second source, or a clock that was set back."""
        assert self.end is not None
        if (self.end - tick - len(rows)) * self._period >= self._clock_reset_threshold():
            return Receipt.CLOCK_RESET
        self._repeated_from = tick if self._repeated_from is None else min(tick, self._repeated_from)
        if any(first <= tick < end for first, end in self.gaps):
            return Receipt.LATE
        if self._contradicts(tick, rows):
            if self.replace and self._replaces(tick, rows):
                return Receipt.REPLACED
            self.conflicted = now
            return Receipt.CONFLICT
        return Receipt.DUPLICATE

    def _contradicts(self, tick: int, rows: Array) -> bool:
        """Compare these rows with those that came last: True when they differ in a tick that both have."""
        if self._newest is None:
            return False
        first, newest = self._newest
        begin, end = max(first, tick), min(first + len(newest), tick + len(rows))
        return begin < end and not np.array_equal(rows[begin - tick : end - tick], newest[begin - first : end - first])

    def _replaces(self, tick: int, rows: Array) -> bool:
        """Put these rows in the place of those that came last; False when that was done too many ticks in a row."""
        assert self._newest is not None
        if tick >= self._replaced_end:
            self._replaced_in_a_row = self._replaced_in_a_row + 1 if tick == self._replaced_end else 1
            self._replaced_end = tick + len(rows)
        if self._replaced_in_a_row >= MAX_REPLACED:
            return False
        first, newest = self._newest
        begin, end = max(first, tick), min(first + len(newest), tick + len(rows))
        changed = newest.copy()
        changed[begin - first : end - first] = rows[begin - tick : end - tick]
        self._newest = first, changed
        if self._blocks and self._blocks[-1][1] is newest:
            self._blocks[-1] = self._blocks[-1][0], changed
        return True

    def _hold(self, tick: int, rows: Array, now: float) -> None:
        if not self._held:
            self._gap_since = now
        known = self._held.get(tick)
        if known is None or len(rows) > len(known):
            self._held[tick] = rows
            self.held += len(rows) - (0 if known is None else len(known))
        if self.held > self.max_queued_rows:
            self._release(now, give_up=True)

    def _release(self, now: float, give_up: bool) -> None:
        for tick in sorted(self._held):
            assert self.end is not None
            if tick > self.end and not give_up:
                return
            rows = self._held.pop(tick)
            self.held -= len(rows)
            if tick + len(rows) > self.end:
                if tick > self.end:
                    self._begin()
                self._append(max(tick, self.end), rows[max(self.end - tick, 0) :])
                self._gap_since = now  # of the next one

    def _append(self, tick: int, rows: Array) -> None:
        """Put rows behind those that wait; what is missing between them is lost."""
        end, count = self.end, len(rows)
        if tick != end and end is not None:
            self.missed += tick - end
            self.gaps.append((end, tick))
        self._blocks.append((tick, rows))
        self.end = tick + count
        self.available += count
        if self.drop_oldest:
            while self.available - len(self._blocks[0][1]) >= self.max_queued_rows:
                oldest = len(self._blocks.popleft()[1])
                self.available -= oldest
                self.dropped += oldest


def waits(signals: Mapping[str, SignalRows], now: float) -> list[Wait]:
    """Signals that a receiver waits for, by topic: of those without a row to take the ones that are furthest behind."""
    empty = {topic: rows for topic, rows in signals.items() if not (rows.joined and rows.available)}
    due = min((rows.awaited for rows in empty.values()), default=0)
    return [Wait(topic, due, now - rows.arrived) for topic, rows in empty.items() if rows.awaited == due]


def tick_at(time: float, period: float) -> int | None:
    """Tick of a time, both in s with the period, or None when it is none."""
    exact = time / period
    if not math.isfinite(exact):
        return None
    tick = round(exact)
    return tick if abs(exact - tick) <= CLOCK_TOLERANCE and 0 <= tick <= MAX_TICK else None


def first_tick(block: Annotated[Array, "N C"], period: float) -> int | None:
    """Tick of the first row of a block, or None when its times are not successive multiples of the period."""
    tick, rows = tick_at(float(block[0, 0]), period), len(block)
    if tick is not None and rows > 1 and not np.max(np.abs(block[:, 0] / period - np.arange(tick, tick + rows))) <= CLOCK_TOLERANCE:
        return None
    return tick


def successive_parts(block: Annotated[Array, "N C"], period: float) -> list[tuple[int | None, Array]]:
    """Parts of a block within which the times are successive, each with the tick of its first row, or None where that is none."""
    if not len(block):
        return []
    tick = first_tick(block, period)
    if tick is not None or len(block) == 1:
        return [(tick, block)]
    with np.errstate(invalid="ignore", over="ignore"):  # times may be anything
        breaks = np.flatnonzero(~(np.abs(np.diff(block[:, 0]) / period - 1.0) < CLOCK_TOLERANCE)) + 1
    return [(first_tick(part, period), part) for part in np.split(block, breaks)]
