# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The columns of a file that are named, by number, name or path, whatever the file is."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.records.tables.containers import Container, read_container, sheet_lines
from hyst_control.records.tables.header import without_unit
from hyst_control.records.tables.text import TextTable, text_table

SHEETS = (".xlsx", ".xlsm")
WIDE = 16  # Columns a row from which a matrix is thought to hold its signals in its rows

_PART = re.compile(r"(?P<name>.*)\((?P<row>:|\d{1,6}),(?P<column>:|\d{1,6})\)")


@dataclass(frozen=True)
class Selected:
    """Columns (N, k) by what they were asked for as, notes, and the sample time (s) where the file states one."""

    columns: dict[str, Array]
    notes: tuple[str, ...] = ()
    sample_time: float | None = None


def open_table(path: Path, variable: str | None = None, skip: int = 0) -> TextTable | Container:
    """A file as a text with a layout, or as arrays. Raises `InputError` where it is neither."""
    if not path.is_file():
        piped = path.exists() and not path.is_dir()
        raise InputError(
            f"{path}: is a pipe or device, which is read once only: save it to a file first"
            if piped
            else f"{path}: does not exist: give the path of a file"
        )
    suffixes = [suffix.lower() for suffix in path.suffixes]
    kind = suffixes[-2] if suffixes[-1:] == [".gz"] and len(suffixes) > 1 else (suffixes[-1] if suffixes else "")
    if kind in SHEETS:
        return text_table(path, skip, sheet_lines(path, variable))
    return read_container(path, kind) or text_table(path, skip)


def read_columns(path: Path, wanted: Sequence[str], variable: str | None = None, skip: int = 0) -> Selected:
    """The wanted columns of a file. Raises `InputError` where one is not there or they differ in length."""
    wanted = list(dict.fromkeys(wanted))
    table = open_table(path, variable, skip)
    return _of_text(table, wanted) if isinstance(table, TextTable) else _of_arrays(path, table, wanted, variable)


def _of_text(table: TextTable, wanted: Sequence[str]) -> Selected:
    layout, first = table.layout, 1
    named = {name: layout.column(name) for name in wanted}
    if named.get("0", 0) is None:
        first = 0
    titles = [layout.title(index) for index in range(layout.width)]
    listed = ", ".join(filter(None, titles))
    found = {
        name: _number(table.path, name, layout.width, first, listed) if index is None else index for name, index in named.items()
    }
    numbers = sorted(set(found.values()))
    rows, notes = table.columns(numbers)
    if not first:
        notes.append(f"{table.path}: columns are numbered from 0, since a column 0 is named")
    return Selected(
        {name: rows[:, numbers.index(index)][:, None] for name, index in found.items()}, tuple(notes), layout.sample_time
    )


def _number(path: str | Path, name: str, width: int, first: int, listed: str) -> int:
    """Number from 0 of the column that a number stands for."""
    if not name.isdecimal():
        raise InputError(f"{path}: has no column {name!r}: {listed or f'number them from {first} to {width - 1 + first}'}")
    if not first <= int(name) < first + width:
        raise InputError(f"{path}: column {name} of {width}: number them from {first} to {width - 1 + first}")
    return int(name) - first


def column_indices(source: str, name: str, names: Sequence[str]) -> list[int]:
    """Numbers from 0 of the columns of this name, with its unit or without, or of this number; a matrix has several."""
    if name in names:
        return [index for index, other in enumerate(names) if other == name]
    bare = [without_unit(other) for other in names]
    if bare.count(without_unit(name)) == 1:
        return [bare.index(without_unit(name))]
    return [_number(source, name, len(names), 1, ", ".join(names))]


def _of_arrays(path: Path, held: Container, wanted: Sequence[str], variable: str | None) -> Selected:
    """Columns of the arrays that are named, or of the one that columns are numbered in."""
    arrays = held.arrays
    found = {name: _named(path, name, arrays) for name in wanted} if variable is None else dict.fromkeys(wanted)
    missing = [name for name, array in found.items() if array is None]
    notes: tuple[str, ...] = ()
    if missing:
        if held.numbered and variable is None:
            one = {name: array for name, array in arrays.items() if array.ndim == 1}
            table = np.column_stack(list(one.values())) if len({len(array) for array in one.values()}) == 1 else None
        else:
            variable = next(iter(arrays)) if variable is None and len(arrays) == 1 else variable
            words = [name for name in missing if not name.isdecimal()]
            if variable is None and words and arrays:
                raise InputError(f"{path}: has no array {', '.join(words)}: name one of {', '.join(arrays)}")
            if variable not in arrays:
                listed = ", ".join(arrays) or "it holds none of numbers"
                raise InputError(f"{path}: name one of its arrays as the variable: {listed}")
            _refuse_wide(path, variable, arrays[variable])
            table = _table(arrays[variable])
        if table is None:
            raise InputError(f"{path}: its columns differ in length: name them: {', '.join(arrays)}")
        first = 0 if "0" in missing else 1
        notes = () if first else (f"{path}: columns are numbered from 0, since a column 0 is named",)
        for name in missing:
            at = _number(path, name, table.shape[1], first, ", ".join(arrays))
            found[name] = table[:, at : at + 1]  # a view: an hour's column is a gigabyte
    columns = {name: array for name, array in found.items() if array is not None}
    if len({len(array) for array in columns.values()}) > 1:
        sizes = ", ".join(f"{name} {len(array)} x {array.shape[1]}" for name, array in columns.items())
        raise InputError(
            f"{path}: the arrays differ in length ({sizes}): rows are samples and columns axes; transpose what is not so, or name its "
            "rows, as in data(1,:)"
        )
    for name in columns:
        if name in arrays:
            _refuse_wide(path, name, arrays[name])
    return Selected(columns, notes, held.sample_time)


def _named(path: Path, name: str, arrays: dict[str, Array]) -> Array | None:
    """The array (N, k) that a name stands for, or a column or row of one; None where there is none."""
    known = _known(name, arrays)
    if known is not None:
        return _vector_or_table(arrays[known])
    match = _PART.fullmatch(name)
    known = _known(match["name"], arrays) if match else None
    if match is None or known is None or (match["row"] == ":") == (match["column"] == ":"):
        return None
    whole = arrays[known]
    table = _vector_or_table(whole) if match["row"] == ":" else _table(whole).T
    number, kind = int(match["column"] if match["row"] == ":" else match["row"]), "columns" if match["row"] == ":" else "rows"
    if not 1 <= number <= table.shape[1]:
        raise InputError(f"{path}: {name}: {match['name']} has {table.shape[1]} {kind}: number them from 1")
    return table[:, number - 1 : number]


def _known(name: str, arrays: dict[str, Array]) -> str | None:
    """An array by its name, with dots or slashes or the braces of a cell, and with or without the unit behind it, where one is so."""
    plain = name.strip("/").replace("/", ".").replace("{", "(").replace("}", ")")
    if name in arrays or plain in arrays:
        return name if name in arrays else plain
    alike = [known for known in arrays if without_unit(known) == name]
    return alike[0] if len(alike) == 1 else None


def _refuse_wide(path: Path, name: str, array: Array) -> None:
    """Refuse a matrix of few rows and very many columns, whose columns would be taken for axes."""
    if array.ndim == 2 and 1 < len(array) and WIDE * len(array) <= array.shape[1]:
        raise InputError(
            f"{path}: {name or 'the array'} is {len(array)} x {array.shape[1]}: its signals lie in its rows: name them as in "
            f"command={name}(1,:)[V],measurement={name}(2,:)[um]"
        )


def _table(array: Array) -> Array:
    """Rows by columns: samples come first; further dimensions (channels, realizations, periods) become columns in their order."""
    if array.ndim < 2:
        return array.reshape(-1, 1)
    return array.reshape(len(array), -1) if array.size else np.empty((len(array), 0))


def _vector_or_table(array: Array) -> Array:
    """The same for an array that a column names: a row vector is a column then."""
    return array.reshape(-1, 1) if array.ndim == 2 and len(array) == 1 else _table(array)
