# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers of a text table: the columns that are wanted, whatever stands beside and above them."""

from __future__ import annotations

import codecs
import gzip
import io
import re
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import Any

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.base.foreign_readers import foreign_reader
from hyst_control.records.bags.decompression import Budget
from hyst_control.records.stream.row_store import RowStore
from hyst_control.records.tables.header import SAMPLE_LINES, Form, Layout, find_layout, header_form, is_comment, is_missing, plain

ENCODING_SAMPLE = 2**12  # Bytes of a text from which its encoding is judged
TEXT_ROWS = 2**14  # Lines of a text that are held at a time

REMEDY = "give a CSV or white-space table, .npy, .npz, .mat, .xlsx, .parquet, .h5, .tdms or .json"

Lines = Iterator[tuple[int, str]]

_ALPHANUMERIC = re.compile(r"[^\W_]")
_CONTROL = re.compile(rb"[\x00-\x08\x0e-\x1f]")


class _Damaged(InputError):
    """A row, by its number in what is being read, that holds no numbers."""

    def __init__(self, row: int, text: str) -> None:
        super().__init__(text)
        self.row = row


@dataclass(frozen=True)
class TextTable:
    """A text with the form that its first lines have; `lines` reads it from its beginning."""

    path: Path
    lines: Callable[[], Lines]
    layout: Layout
    ends_open: Callable[[], bool]  # True where the last line has no line end

    def columns(self, wanted: Sequence[int]) -> tuple[Array, list[str]]:
        """Numbers (N, len(wanted)) of the columns of these numbers from 0, and notes on what was left out below the last number."""
        store, notes = RowStore(len(wanted)), list(self.layout.notes)
        with foreign_reader(self.path, "text", REMEDY):
            source = self.lines()
            header = {header_form(line) for _, line in islice(source, self.layout.first)} - {""}
            lines = ((number, line) for number, line in source if not is_comment(line))
            left: list[tuple[int, str]] = []
            repeated: list[int] = []
            shortest = length = np.inf  # of all lines above the last, and of the last
            while piece := [*left, *islice(lines, TEXT_ROWS - len(left))]:
                left = []
                try:
                    store.append(self._numbers(piece, wanted))
                except _Damaged as damaged:
                    store.append(self._numbers(piece[: damaged.row], wanted))
                    (number, line), left = piece[damaged.row], piece[damaged.row + 1 :]
                    if header_form(line) in header:
                        repeated.append(number)
                    else:
                        notes.append(self._end(number, line, chain(left, lines), damaged))
                        break
                else:
                    shortest = min(shortest, length, *(len(line) for _, line in piece[:-1]), np.inf)
                    last, length = piece[-1][0], len(piece[-1][1])
            else:
                if length < shortest < np.inf and self.ends_open():
                    notes.append(f"the last line, {last}, has no line end and is the shortest: its last number may be cut off")
            if repeated:
                notes.append(f"lines that repeat the header were left out: {len(repeated)}, the first is line {repeated[0]}")
        return store.array(), [f"{self.path}: {note}" for note in notes]

    def _end(self, number: int, line: str, behind: Iterator[tuple[int, str]], damaged: _Damaged) -> str:
        """The note on a line that ends the rows: words below them, or the last row, cut off. Raises `damaged` where it is neither."""
        form, cells, following = self.layout.form, self.layout.form.cells(line), next(behind, None)
        if following is None and len(cells) < self.layout.width and any(map(form.is_number, cells)):
            return f"the last line, {number}, is cut off and was left out"
        rest = chain([(number, line)], [following] if following else [], behind)
        if any(form.is_number(cell) for _, each in rest for cell in form.cells(each)):
            raise damaged
        return f"what stands from line {number} on holds no numbers and was left out"

    def _numbers(self, piece: Sequence[tuple[int, str]], wanted: Sequence[int]) -> Array:
        if not piece:
            return np.empty((0, len(wanted)))
        form, width = self.layout.form, self.layout.width
        text = [line for _, line in piece]
        quoted = any('"' in line for line in text)
        if not quoted and all(_count(line, form) == width for line in text):
            try:
                due = [line.replace(",", ".") for line in text] if form.decimal == "," else text
                return np.loadtxt(due, delimiter=form.separator, usecols=list(wanted), ndmin=2, comments=None)
            except ValueError:
                pass  # a cell that is none, or empty: named below, or no number at all
        table = np.empty((len(piece), len(wanted)))
        for row, (number, line) in enumerate(piece):
            cells = form.cells(line)
            if len(cells) < width or any(cells[width:]):
                raise _Damaged(row, f"{self.path}: line {number} has {len(cells)} columns, the first has {width}: repair the line")
            for place, index in enumerate(wanted):
                value = form.number(cells[index])
                if value is None and is_missing(cells[index]):
                    value = np.nan
                if value is None:
                    raise _Damaged(
                        row, f"{self.path}: line {number}, column {index + 1}: {cells[index]!r} is no number: repair the line"
                    )
                table[row, place] = value
        return table


def text_table(path: Path, skip: int = 0, lines: Callable[[], Lines] | None = None) -> TextTable:
    """A text table, and the form of what stands behind its first `skip` lines. Raises `InputError` when it holds no rows."""
    source = lines or (lambda: _lines(path))

    def behind() -> Lines:
        return ((number, plain(line.rstrip("\n"))) for number, line in source() if number > skip and _ALPHANUMERIC.search(line))

    with foreign_reader(path, "text", REMEDY):
        first = [line for _, line in islice(behind(), SAMPLE_LINES)]
        if not any(not is_comment(line) for line in first):
            raise InputError(f"{path}: holds no rows")
        layout = find_layout(first)
    if layout is None:
        words = next(line for line in first if not is_comment(line))
        if len(first) == 1:
            raise InputError(f"{path}: holds no rows below its first line ({words[:40]!r} is taken as names): repair it")
        raise InputError(f"{path}: holds no rows of numbers ({words[:40]!r}, …): name the lines to skip (--skip N), or repair it")
    return TextTable(path, behind, layout, lambda: lines is None and not deque(source(), maxlen=1)[0][1].endswith("\n"))


def _lines(path: Path) -> Lines:
    """Lines of a text with their numbers and line ends."""
    budget = Budget(path.stat().st_size)
    with open(path, "rb") as plain_file:
        file: Any = gzip.open(plain_file) if path.suffix.lower() == ".gz" else plain_file
        encoding = _encoding(file.read(ENCODING_SAMPLE))
        file.seek(0)
        with io.TextIOWrapper(file, encoding) as text:
            for number, line in enumerate(text, start=1):
                budget.take(len(line))
                yield number, line


def _encoding(start: bytes) -> str:
    """Encoding of a text that begins with these bytes: Unicode, else the one in which western instruments write their µ."""
    if start[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        return "utf-16"
    if len(start) > 8 and start[1::2].count(0) > 0.8 * len(start[1::2]):
        return "utf-16-le"
    try:
        codecs.getincrementaldecoder("utf-8-sig")().decode(start)
    except UnicodeDecodeError:
        return "utf-8-sig" if _CONTROL.search(start) else "cp1252"
    return "utf-8-sig"


def _count(line: str, form: Form) -> int:
    return len(line.split()) if form.separator is None else line.count(form.separator) + 1
