# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Parts of long records on which structures are compared: some evenly spread, the others where a model's error is largest.

A sweep passes each mode in a few rows, so no fixed choice of parts sees all modes of a long one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.identify.solve.gram_sums import Window
from hyst_control.records.stream.row_store import blocks

SEARCH_ROWS = 40_000  # Rows on which structures are compared
EVEN, WORST = 2, 2  # Parts of a longer record: evenly spread, and where a model's error is largest
CANDIDATES = 100  # Parts of a record of which the worst are taken
LEAST_ROWS = 64  # Of a part


@dataclass(frozen=True)
class Parts:
    """Parts of records; of short ones the whole."""

    records: Sequence[Window]
    begins: tuple[tuple[int, ...], ...]  # First rows of the parts of every record, in order

    def windows(self) -> list[Window]:
        """The parts in which the command moves, each with session effects of its own."""
        found = [self._cut(record, begin) for record, begins in zip(self.records, self.begins, strict=True) for begin in begins]
        moving = [part for part in found if np.ptp(part.command) > 0]
        return [replace(part, group=number) for number, part in enumerate(moving)]

    def with_worst(self, error: Callable[[Window], float], least: float = 0.0) -> Parts:
        """The same with more parts of long records, where the error of a model is largest and above `least`."""
        found = [self._worst(record, known, error, least) for record, known in zip(self.records, self.begins, strict=True)]
        return replace(self, begins=tuple(found))

    def cuts(self, record: Window) -> Iterator[Window]:
        """Candidates for a part."""
        return (self._cut(record, begin) for begin in self._candidates(record))

    def _candidates(self, record: Window) -> list[int]:
        """First rows of parts, one beside the other; of a short record 0."""
        last = len(record.command) - self._size(record)
        return [int(begin) for begin in np.linspace(0, last, CANDIDATES if last else 1)]

    def _worst(self, record: Window, known: tuple[int, ...], error: Callable[[Window], float], least: float) -> tuple[int, ...]:
        begins, size, found = self._candidates(record), self._size(record), list(known)
        if len(begins) == 1:
            return known
        left = [error(self._cut(record, begin)) for begin in begins]
        for index in np.argsort(left)[::-1]:
            apart = min(abs(begins[index] - other) for other in found) >= size
            if apart and left[index] > least and len(found) < len(known) + WORST:
                found.append(_to_motion(record.command, begins[index], size))
        return tuple(sorted(set(found)))

    def _size(self, record: Window) -> int:
        rows = len(record.command)
        share = SEARCH_ROWS / sum(len(each.command) for each in self.records)
        size = max(int(share * rows / (EVEN + WORST)), LEAST_ROWS)
        return rows if share >= 1.0 or size * (EVEN + WORST) >= rows else size

    def _cut(self, record: Window, begin: int) -> Window:
        rows = slice(begin, begin + self._size(record))
        return replace(record, command=record.command[rows], measurement=record.measurement[rows])


def first_parts(records: Sequence[Window]) -> Parts:
    """Parts evenly spread, and those where the measurement departs most from a gain."""
    parts = Parts(records, ((0,),) * len(records))
    spread = []
    for record in records:
        size = len(next(parts.cuts(record)).command)
        begins = np.linspace(0, len(record.command) - size, EVEN).astype(int).tolist()
        spread.append(tuple(sorted({_to_motion(record.command, begin, size) for begin in begins})))
    parts = replace(parts, begins=tuple(spread))
    departures = {record.group: _departure(parts.cuts(record), record) for record in records}
    return parts.with_worst(lambda part: departures[part.group](part))


def _departure(cuts: Iterator[Window], record: Window) -> Callable[[Window], float]:
    """Sum of squares by which a part departs from the gain and zero of its record."""

    def motions(part: Window) -> tuple[Array, Array]:
        return part.command - record.command[0], part.measurement - record.measurement[0]

    # Part by part: a long record stays on the disk.
    sums = sum(np.array([len(u), u.sum(), y.sum(), u @ u, u @ y]) for u, y in map(motions, cuts))
    rows, first, second, square, product = np.asarray(sums, dtype=float)
    slope = (product - first * second / rows) / max(square - first**2 / rows, 1e-300)
    zero = (second - slope * first) / rows

    def left(part: Window) -> float:
        u, y = motions(part)
        return float(np.sum((y - slope * u - zero) ** 2))

    return left


def _to_motion(command: Array, begin: int, size: int) -> int:
    """First row of a part, or where the command rests in it of one around its next change."""
    if np.ptp(command[begin : begin + size]) > 0.0:
        return begin
    for rows in blocks(len(command) - begin):  # block by block: a long record stays on the disk
        moved = np.flatnonzero(command[begin + rows.start : begin + rows.stop] != command[begin])
        if len(moved):
            return min(begin + int(rows.start + moved[0]) - size // 8, len(command) - size)
    return begin
