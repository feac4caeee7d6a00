# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Rows of numbers of any count: in memory while they are few, in a temporary file mapped into memory when they are many.

The file has no name and vanishes with the last array on it. Its pages belong to the system, which writes them out and takes them back as
it needs memory: an hour at 50 kHz is read, simulated and written in the memory of some blocks. Files lie in the folder that TMPDIR names.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from typing import BinaryIO

import numpy as np

from hyst_control.base.arrays import Array, Mask
from hyst_control.base.errors import InputError

IN_MEMORY = 2**25  # Bytes from which rows go to a file: 4 million numbers, 80 s at 50 kHz
BLOCK = 2**18  # Rows that are worked on at a time
PREFIX = "hyst-rows-"  # Of a temporary file's name


def blocks(count: int) -> Iterator[slice]:
    """Slices that cover `count` rows in order, `BLOCK` rows each but the last."""
    return (slice(begin, min(begin + BLOCK, count)) for begin in range(0, count, BLOCK))


def empty_rows(*shape: int) -> Array:
    """Array of a shape, to be filled: in memory, or on a temporary file where it is large."""
    size = 8 * int(np.prod(shape, dtype=np.int64))
    if size <= IN_MEMORY:
        return np.empty(shape)
    with tempfile.TemporaryFile(prefix=PREFIX) as file:
        try:
            file.truncate(size)
        except OSError as error:
            raise InputError(_no_room(size, error)) from None
        return _mapped(file, shape)


def mean_square(values: Array, less: float = 0.0) -> float:
    """Mean of (values - less)² over an array (N,) of at least one number; block by block."""
    total = sum(float(np.sum((values[part] - less) ** 2)) for part in blocks(len(values)))
    return total / len(values)


def largest_size(values: Array) -> float:
    """Largest absolute value of an array of `values`, which is not empty."""
    return max(float(values.max()), -float(values.min()))


def all_finite(values: Array) -> bool:
    """Check that all `values` (N, ...) are finite, block by block."""
    return all(bool(np.all(np.isfinite(values[part]))) for part in blocks(len(values)))


def column(values: Array, index: int) -> Array:
    """Column `index` (N,) of an array `values` (N, A), contiguous; on a temporary file where it is large and has to be copied."""
    one = values[:, index]
    if one.flags.c_contiguous:
        return one
    found = empty_rows(len(one))
    for part in blocks(len(one)):
        found[part] = one[part]
    return found


def total_variation(values: Array, begin: int = 0) -> float:
    """Sum of the changes' sizes of `values` (N,) from row `begin` on; block by block."""
    rest = values[begin:]
    return float(sum(np.abs(np.diff(rest[part.start : part.stop + 1])).sum() for part in blocks(len(rest))))


def largest_change(values: Array) -> float:
    """Largest size of a change between neighbors of `values` (N,), of two or more; block by block."""
    return max(float(np.abs(np.diff(values[part.start : part.stop + 1])).max(initial=0.0)) for part in blocks(len(values)))


def first_row(count: int, found: Callable[[slice], Mask]) -> int:
    """First of `count` rows for which something holds; `count` where there is none."""
    for part in blocks(count):
        rows = np.flatnonzero(found(part))
        if len(rows):
            return int(part.start + rows[0])
    return count


def spread_parts(count: int, most: int, parts: int = 16) -> list[slice]:
    """All of `count` rows as one part, or of more than `most` so many in `parts` of equal size, spread evenly over them."""
    if count <= most:
        return [slice(0, count)]
    size = max(most // parts, 1)
    return [slice(begin, begin + size) for begin in np.linspace(0, count - size, parts).astype(int).tolist()]


class RowStore:
    """Rows that come block by block."""

    def __init__(self, width: int | None = None) -> None:
        self.width = width
        self.count = 0
        self._blocks: list[Array] = []
        self._held = 0
        self._file: BinaryIO | None = None

    def append(self, rows: Array) -> None:
        """Append rows (N, width), or (N,); they are copied where they are a view."""
        self.count += len(rows)
        self._blocks.append(np.array(rows, dtype=np.float64, order="C"))
        self._held += rows.size * 8
        if self._held > IN_MEMORY:
            self._spill()

    def array(self) -> Array:
        """All rows (N, width), or (N,); nothing can be appended afterwards."""
        shape = (self.count,) if self.width is None else (self.count, self.width)
        if self._file is None:
            found = np.concatenate(self._blocks) if self._blocks else np.empty(shape)
            self._blocks = []
            return found
        self._spill()
        with self._file as file:
            return _mapped(file, shape)

    def _spill(self) -> None:
        if self._file is None:
            self._file = tempfile.TemporaryFile(prefix=PREFIX)
        try:
            for block in self._blocks:
                self._file.write(block.data)
            self._file.flush()
        except OSError as error:
            raise InputError(_no_room(8 * self.count * (self.width or 1), error)) from None
        self._blocks, self._held = [], 0


def _mapped(file: BinaryIO, shape: tuple[int, ...]) -> Array:
    return np.asarray(np.memmap(file, np.float64, "r+", shape=shape))


def _no_room(size: int, error: OSError) -> str:
    return (
        f"{tempfile.gettempdir()}: no room for {size / 2**20:.0f} MiB of rows ({error.strerror}): "
        "name a folder with more room in TMPDIR"
    )
