# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Page of the papers' experiments from the results of `hyst reproduce hampi|mhl`: targets met and missed, then every row."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from evaluation.reproduction.targets import Rows, Target, hampi_targets, mhl_targets
from hyst_control.base.errors import InputError
from hyst_control.base.files import read_json, write_text
from hyst_control.reporting.table_page import markdown
from hyst_control.reporting.tables import SCHEMA, Row, Table
from hyst_control.reporting.templates import render

SOURCES = ("reproduce hampi", "reproduce mhl")


def read_result(path: str | Path) -> Table:
    """Read the table of a result file."""
    document = read_json(path)
    if document.get("schema") != SCHEMA or document.get("source") not in SOURCES:
        raise InputError(f"{path}: is no result of hyst reproduce hampi or mhl")
    try:
        return Table(document["source"], [_row(row) for row in document["rows"]], document["machine"], document.get("notes", []))
    except (KeyError, TypeError):
        raise InputError(f"{path}: its rows are none of hyst reproduce: run it again with --json") from None


def _row(values: dict[str, Any]) -> Row:
    return Row(**{**values, "value": math.nan if values["value"] is None else values["value"]})


TARGETS: dict[str, tuple[str, Callable[[Rows], list[Target]]]] = {
    "reproduce hampi": ("HAMPI: piezo actuator", hampi_targets),
    "reproduce mhl": ("MHL: fast steering mirror", mhl_targets),
}


def write_page(results: Sequence[str | Path], path: str | Path) -> None:
    """Write the page of results."""
    tables = [read_result(result) for result in results]
    files = [f"{table.source.split()[-1]}.json" for table in tables]
    text = render(
        "reproduction/templates/reproduction.md",
        files=files,
        commands=[f"`hyst {table.source} --json {file}`" for table, file in zip(tables, files, strict=True)],
        results=[_section(table) for table in tables],
    )
    write_text(path, text.rstrip() + "\n")


def _section(table: Table) -> dict[str, object]:
    """Values of the page's section on one experiment."""
    title, targets = TARGETS[table.source]
    return {"title": title, "targets": targets(Rows(table.rows)), "notes": table.notes, "tables": markdown(table)}
