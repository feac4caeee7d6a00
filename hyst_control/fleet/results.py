# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A study's results: Parquet files with one row a record, which pandas, polars and DuckDB read as they are.

Rows are appended in parts while a study runs, so that nothing that was computed is lost. At its end all parts become one file.
"""

from __future__ import annotations

import os
import re
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from hyst_control.base.errors import InputError
from hyst_control.base.files import replacing

ROWS_PER_PART = 256
SECONDS_PER_PART = 10.0
DONE, FAILED = "done", "failed"
NUMBER = re.compile(r"[+-]?(0|[1-9]\d{0,14})(\.\d*)?([eE][+-]?\d{1,2})?|nan", re.IGNORECASE)
"""A text that a double holds; names such as 007 or a long serial number are none."""
OTHERS = "others.parquet"  # Results of records that the manifest does not list
OWN = ("unit", "time", "moment", "bag", "status", "reason", "mark")  # Columns that every table of results has


def arrow() -> Any:
    """Give pyarrow, with its Parquet module."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ModuleNotFoundError:
        raise InputError("Parquet: pyarrow is not installed: pip install 'hyst_control[fleet]'") from None
    return pyarrow


def schema(kind: str, columns: Sequence[str], numeric: Collection[str] = ()) -> Any:
    """Columns of a study's rows; `numeric` ones of the manifest's are numbers, others texts."""
    pa = arrow()
    text, number = pa.string(), pa.float64()

    def several(**members: Any) -> Any:
        return pa.list_(pa.struct(list(members.items())))

    parameter = {"name": text, "value": number, "low": number, "high": number, "unit": text}
    own: dict[str, Sequence[tuple[str, Any]]] = {
        "identify": [
            ("family", text),
            ("model_file", text),
            ("held_out_nrmse", pa.list_(number)),
            ("parameters", several(name=text, value=number)),
        ],
        "validate": [("errors", several(axis=text, nrmse=number, nrmse_centered=number, nme=number, rmse=number))],
        "diagnose": [
            ("report_file", text),
            ("page_file", text),
            ("verdict", text),
            ("reasons", pa.list_(text)),
            ("gap_rms", number),
            ("gap_nrmse", number),
            ("floor_rms", number),
            ("left_rms", number),
            ("measurement_unit", text),
            ("effects", several(name=text, probability=number, shrink=number, parameters=several(**parameter))),
            ("deviations", several(name=text, z=number)),
        ],
    }
    common = [("unit", text), ("time", text), ("moment", number), ("bag", text), ("model", text), ("baseline", pa.list_(text))]
    ends = [("status", text), ("reason", text), ("seconds", number), ("version", text), ("mark", text)]
    return pa.schema([*common, *own[kind], *ends, *((name, number if name in numeric else text) for name in columns)])


class Results:
    """Rows of a study in its folder, written in parts as they come."""

    def __init__(self, folder: Path, kind: str, columns: Sequence[str]) -> None:
        self.whole, self._others, self._parts = folder / "records.parquet", folder / OTHERS, folder / "parts"
        self._kind, self._columns = kind, columns
        self._schema = schema(kind, columns)
        self._waiting: list[Mapping[str, Any]] = []
        self._written = time.monotonic()

    def newest(self, columns: list[str] | None = None) -> dict[str, dict[str, Any]]:
        """Newest row of every record that was ever computed here, by its bag, with these columns or all."""
        return {row["bag"]: row for row in self.rows(columns, [self._others])}

    def marks(self) -> dict[str, str]:
        """Mark of every record that is done, by its bag."""
        newest = self.newest(["bag", "mark", "status"])
        return {bag: row["mark"] for bag, row in newest.items() if row["status"] == DONE}

    def add(self, row: Mapping[str, Any]) -> None:
        """Append a row."""
        self._waiting.append(row)
        if len(self._waiting) >= ROWS_PER_PART or time.monotonic() > self._written + SECONDS_PER_PART:
            self.flush()

    def flush(self) -> None:
        """Write the rows that wait as a part."""
        self._written = time.monotonic()
        if not self._waiting:
            return
        self._parts.mkdir(parents=True, exist_ok=True)
        taken = [int(file.stem) for file in self._parts.glob("*.parquet") if file.stem.isdigit()]
        self._write(self._parts / f"{max(taken, default=-1) + 1:06d}.parquet", self._waiting)
        self._waiting = []

    def join(self, rows: Sequence[Mapping[str, Any]]) -> int:
        """Make one file of the rows of a manifest, with numbers in columns that hold nothing else; the number of others that are kept."""
        bags = {row["bag"] for row in rows}
        # Results of another manifest's records: no part of this study, but not to be computed again under that manifest.
        others = [row for bag, row in self.newest().items() if bag not in bags and row["status"] == DONE]
        self._waiting = [*others]  # in a part until both files are written: an end between them loses nothing
        self.flush()
        numeric = [name for name in self._columns if _is_numeric([row.get(name) or "" for row in rows])]
        rows = [{**row, **{name: float(row[name]) if row.get(name) else None for name in numeric}} for row in rows]
        self._write(self.whole, rows, schema(self._kind, self._columns, numeric))
        if others:
            self._write(self._others, others)
        else:
            self._others.unlink(missing_ok=True)
        for file in self._parts.glob("*.parquet"):
            file.unlink()
        if self._parts.is_dir():
            os.rmdir(self._parts)
        return len(others)

    def rows(self, columns: list[str] | None = None, before: Sequence[Path] = ()) -> Iterator[dict[str, Any]]:
        """Rows of all files, those `before` first, with these columns or all, the manifest's as texts; a record's newest comes last."""
        pa = arrow()
        for file in filter(Path.exists, (*before, self.whole, *sorted(self._parts.glob("*.parquet")))):
            try:
                with pa.parquet.ParquetFile(file) as opened:
                    held = opened.schema_arrow
                    for name in OWN:
                        if name not in held.names or held.field(name).type != self._schema.field(name).type:
                            raise InputError(f"{file}: is no table of results, its column {name} is missing or another: remove it")
                    for batch in opened.iter_batches(columns=columns):
                        yield from map(self._with_texts, batch.to_pylist())
            except (OSError, pa.ArrowException) as error:
                reason = str(error).split("\n")[0]
                raise InputError(f"{file}: cannot be read ({reason}): remove it, its records are computed again") from None

    def _with_texts(self, row: dict[str, Any]) -> dict[str, Any]:
        return {**row, **{name: repr(row[name]).removesuffix(".0") for name in self._columns if isinstance(row.get(name), float)}}

    def _write(self, path: Path, rows: Sequence[Mapping[str, Any]], columns: Any = None) -> None:
        pa = arrow()
        with replacing(path) as file:
            pa.parquet.write_table(pa.Table.from_pylist([dict(row) for row in rows], schema=columns or self._schema), file)


def _is_numeric(texts: Sequence[str]) -> bool:
    """Tell a column of numbers, where there is one and not equal ones of different spelling, as versions 1.1 and 1.10 are."""
    given = {text for text in texts if text}
    return bool(given) and all(map(NUMBER.fullmatch, given)) and len(set(map(float, given))) == len(given)
