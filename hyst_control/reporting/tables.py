# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Result tables: the one JSON form of every command that prints figures, and the same rows as aligned text."""

from __future__ import annotations

import math
import os
import platform
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from hyst_control.base.files import write_json

SCHEMA = "hyst_control/table"
VERSION = 1


@dataclass(frozen=True)
class Limit:
    """The figure that the same work has on the same machine with nothing around it."""

    value: float
    of: str  # What does that work, such as "bare C loop"


@dataclass(frozen=True)
class Row:
    """One figure."""

    table: str  # Table it belongs to, such as "HAMPI Table 5"
    case: str  # Operating point, such as "100 Hz"
    subject: str  # Model, controller, executor or effect it is about
    quantity: str
    unit: str
    value: float
    published: float | None = None  # Published value to compare with
    n: int | None = None  # Number of samples, cases or repetitions
    ci95: tuple[float, float] | None = None  # 95 % confidence interval [lower, upper]
    limit: Limit | None = None

    @property
    def ratio(self) -> float:
        """The figure as a multiple of its limit: 1 at the limit, larger the further it is from it, rates and times alike."""
        limit = self.limit.value if self.limit else math.nan
        return limit / self.value if self.unit.endswith(("/s", "Hz")) else self.value / limit


@dataclass
class Table:
    """Rows of one source, in the order in which they are printed."""

    source: str  # Such as "reproduce hampi"
    rows: list[Row] = field(default_factory=list)
    machine: str = ""  # Description of the machine, where the figures depend on it
    notes: list[str] = field(default_factory=list)  # Sentences on the limits of the figures
    exit_status: int = 0  # Exit status of the command that prints it

    def add(
        self,
        table: str,
        case: str,
        subject: str,
        quantity: str,
        unit: str,
        value: float,
        *,
        published: float | None = None,
        n: int | None = None,
        ci95: tuple[float, float] | None = None,
        limit: Limit | None = None,
    ) -> None:
        """Append one `Row`; numpy numbers become Python ones.

        Arguments as its fields: table, case, subject, quantity, unit, value, published, n, ci95, limit.
        """
        known, count = None if published is None else float(published), None if n is None else int(n)
        interval = None if ci95 is None else (float(ci95[0]), float(ci95[1]))
        self.rows.append(Row(table, case, subject, quantity, unit, float(value), known, count, interval, limit))

    def value(self, case: str, subject: str, quantity: str) -> float:
        """Value of the one row with this case, subject and quantity.

        Raises `KeyError` where there is no such row, or more than one.
        """
        found = [row.value for row in self.rows if (row.case, row.subject, row.quantity) == (case, subject, quantity)]
        if len(found) != 1:
            raise KeyError(f"{len(found)} rows for {case}, {subject}, {quantity}")
        return found[0]

    def document(self) -> dict[str, Any]:
        """The table as plain JSON types; a value that is not a finite number becomes null."""
        rows = [{key: _number(value) for key, value in _named(row).items()} for row in self.rows]
        return {
            "schema": SCHEMA,
            "version": VERSION,
            "source": self.source,
            "machine": self.machine or machine(),
            "rows": rows,
            **({"notes": self.notes} if self.notes else {}),
        }

    def text(self) -> str:
        """The rows as aligned columns under one heading per table."""
        lines: list[str] = []
        for name in dict.fromkeys(row.table for row in self.rows):
            rows = [row for row in self.rows if row.table == name]
            optional = [
                ("published", [_figure(row.published) for row in rows]),
                ("95 %", ["" if row.ci95 is None else f"{_figure(row.ci95[0])} … {_figure(row.ci95[1])}" for row in rows]),
                ("count", ["" if row.n is None else str(row.n) for row in rows]),
                ("limit", [_figure(row.limit.value) if row.limit else "" for row in rows]),
                ("x limit", [_figure(row.ratio) if row.limit else "" for row in rows]),
                ("of", [row.limit.of if row.limit else "" for row in rows]),
            ]
            columns = [
                ("case", [row.case for row in rows]),
                ("subject", [row.subject for row in rows]),
                ("quantity", [row.quantity for row in rows]),
                ("value", [_figure(row.value) for row in rows]),
                ("unit", [row.unit for row in rows]),
                *(column for column in optional if any(column[1])),
            ]
            headers, cells = [header for header, _ in columns], list(zip(*(cells for _, cells in columns), strict=True))
            lines += [
                *([""] if lines else []),
                name,
                *aligned(headers, cells, ("value", "published", "count", "limit", "x limit")),
            ]
        return "\n".join([*lines, *([""] if self.notes else []), *self.notes])

    def write(self, path: str | Path) -> None:
        """Write the table as JSON to a path; raises `InputError` where the file cannot be written."""
        write_json(path, self.document())


def aligned(headers: Sequence[str], rows: Sequence[Sequence[str]], right: Sequence[str] = ()) -> list[str]:
    """Lines of a table with columns as wide as their widest cell; those whose headers are in `right` are flush right."""
    widths = [max(len(header), *(len(row[i]) for row in rows), 0) for i, header in enumerate(headers)]

    def line(cells: Sequence[str]) -> str:
        padded = [
            cell.rjust(width) if header in right else cell.ljust(width)
            for header, cell, width in zip(headers, cells, widths, strict=True)
        ]
        return "  " + "  ".join(padded).rstrip()

    return [line(headers), *(line(row) for row in rows)]


def machine() -> str:
    """Processor, cores and Python, for whoever reads a timing later."""
    return f"{platform.machine()} {platform.system()}, {os.cpu_count()} cores, Python {platform.python_version()}"


def _named(row: Row) -> dict[str, Any]:
    """The row by name; with its limit and the ratio only where there is a limit."""
    named = asdict(row)
    limit = named.pop("limit")
    return named if limit is None else {**named, "limit": limit["value"], "limit_of": limit["of"], "ratio": row.ratio}


def _number(value: object) -> object:
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return [_number(item) for item in value] if isinstance(value, tuple) else value


def _figure(value: float | None) -> str:
    if value is None:
        return ""
    size = abs(value)
    if not math.isfinite(value):
        return str(value)
    if value == 0 or 1e-3 <= size < 1e7:
        return f"{value:.0f}" if size >= 1000 or value == int(value) else f"{value:.4g}" if size < 1 else f"{value:.2f}"
    return f"{value:.3g}"
