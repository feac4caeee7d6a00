# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Arrays by name out of files of other programs: NumPy, MATLAB, HDF5, Parquet, TDMS, JSON, universal files; sheets of a workbook."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.base.foreign_readers import foreign_reader
from hyst_control.records.bags.decompression import Budget
from hyst_control.records.tables.array_files import KINDS, hdf5_arrays, read_arrays, real_arrays
from hyst_control.records.tables.header import Form
from hyst_control.records.tables.universal_file import universal_arrays

JSON_NUMBERS = Form(",", ".")  # Form of numbers and moments that are texts in JSON
REMEDY = "check how it was written, or save it as CSV"
KINDS_BY_LIBRARY = {"openpyxl": "an Excel workbook", "pyarrow": "a Parquet file", "h5py": "an HDF5 file", "npTDMS": "a TDMS file"}
OTHERS = {
    ".xls": "an old Excel workbook",
    ".ods": "an OpenDocument sheet",
    ".feather": "a Feather file",
    ".pkl": "a pickled object",
}


@dataclass(frozen=True)
class Container:
    """Arrays of real numbers by name; sample_time: s, where the file states it; numbered: they are the columns of one table."""

    arrays: dict[str, Array]
    sample_time: float | None = None
    numbered: bool = True


def read_container(path: Path, kind: str) -> Container | None:
    """Arrays of a file of this ending; None where it is a text. Raises `InputError` where it cannot be read."""
    if kind in OTHERS:
        raise InputError(f"{path}: is {OTHERS[kind]}: save it as .xlsx, .parquet or CSV")
    if kind in KINDS:
        return Container(read_arrays(path, kind), numbered=False)
    if kind not in _READERS:
        return None
    needed, read = _READERS[kind]
    library = optional_library(needed, path)
    with foreign_reader(path, f"a {kind} file", REMEDY):
        return read(path, library)


def optional_library(name: str, path: Path) -> Any:
    """A library that not everybody needs. Raises `InputError` where it is not installed."""
    try:
        return import_module(name)
    except ModuleNotFoundError:
        package = name.partition(".")[0].replace("nptdms", "npTDMS")
        raise InputError(
            f"{path}: is {KINDS_BY_LIBRARY[package]}, and {package}, which reads it, is not installed: pip install {package}, or save "
            "it as CSV"
        ) from None


def sheet_lines(path: Path, sheet: str | None) -> Callable[[], Iterator[tuple[int, str]]]:
    """Rows of a sheet of an .xlsx workbook (None: the first that holds numbers) as numbered lines, cells apart by tabs."""
    library = optional_library("openpyxl", path)
    with foreign_reader(path, "an Excel workbook", REMEDY):
        budget = Budget(path.stat().st_size)
        with zipfile.ZipFile(path) as archive:
            for member in archive.infolist():
                budget.take(member.file_size)
        book = library.load_workbook(path, read_only=True, data_only=True)
        names = book.sheetnames
        if sheet is not None and sheet not in names:
            raise InputError(f"{path}: has no sheet {sheet}: name one of {', '.join(names)} as the variable")
        for name in [sheet] if sheet is not None else names:
            rows = [list(row) for row in book[name].iter_rows(values_only=True)]
            lines = [(number, "\t".join(map(_cell_text, row))) for number, row in enumerate(rows, start=1)]
            if any(isinstance(cell, (int, float)) for row in rows for cell in row):
                break
    return lambda: iter(lines)


def _cell_text(cell: Any) -> str:
    return "" if cell is None else cell.isoformat(sep=" ") if hasattr(cell, "isoformat") else str(cell).replace("\t", " ")


def _parquet(path: Path, library: Any) -> Container:
    file = library.ParquetFile(path)
    Budget(path.stat().st_size).take(8 * file.metadata.num_rows * file.metadata.num_columns)
    columns = file.read().flatten()
    return Container(real_arrays({name: columns[name].to_numpy() for name in dict.fromkeys(columns.column_names)}))


def _json(path: Path, library: Any) -> Container:
    """One document, or one in each line."""
    text = path.read_text("utf-8-sig")
    try:
        content = library.loads(text)
    except ValueError:
        content = [library.loads(line) for line in text.splitlines() if line.strip()]
    found: dict[str, Any] = {}
    _series("", content, found)
    return Container(real_arrays(found))


def _series(name: str, content: Any, found: dict[str, Any]) -> None:
    """Collect series of numbers by their path: lists of them, and the values under a key in a list of objects."""
    if isinstance(content, list) and content and all(isinstance(row, dict) for row in content):
        content = {key: [row.get(key) for row in content] for key in dict.fromkeys(key for row in content for key in row)}
    if isinstance(content, dict):
        for key, inner in content.items():
            _series(f"{name}.{key}" if name else str(key), inner, found)
    elif isinstance(content, list):
        numbers = [JSON_NUMBERS.number(one) if isinstance(one, str) else one for one in content]
        try:
            found[name or "1"] = np.array([np.nan if one is None else one for one in numbers], dtype=np.float64)
        except (TypeError, ValueError):
            pass  # lists of other things


def _tdms(path: Path, library: Any) -> Container:
    budget = Budget(path.stat().st_size)
    found, increments = {}, set()
    with library.TdmsFile.open(path) as file:
        for group in file.groups():
            for channel in group.channels():
                budget.take(8 * len(channel))
                found[f"{group.name}.{channel.name}"] = channel[:]
                increments.add(channel.properties.get("wf_increment"))
    increment = increments.pop() if len(increments) == 1 else None
    return Container(real_arrays(found), sample_time=float(increment) if increment else None)


_READERS: dict[str, tuple[str, Callable[[Path, Any], Container]]] = {
    ".parquet": ("pyarrow.parquet", _parquet),
    **dict.fromkeys((".h5", ".hdf5"), ("h5py", lambda path, _: Container(hdf5_arrays(path), numbered=False))),
    ".tdms": ("nptdms", _tdms),
    **dict.fromkeys((".json", ".jsonl", ".ndjson"), ("json", _json)),
    **dict.fromkeys((".uff", ".unv", ".uf", ".58"), ("numpy", lambda path, _: Container(*universal_arrays(path)))),
}
CONTAINERS = tuple(_READERS)
