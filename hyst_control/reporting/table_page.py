# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The rows of a result by table, and as Markdown: the published value beside each."""

from __future__ import annotations

from hyst_control.reporting.tables import Row, Table
from hyst_control.reporting.templates import render

HEADERS = ("case", "subject", "quantity", "measured", "published", "unit")


def markdown(table: Table) -> str:
    """Convert a result to Markdown, each table under its name."""
    tables = {name: [cells(row) for row in rows] for name, rows in by_name(table).items()}
    return render("reporting/templates/tables.md", headers=HEADERS, tables=tables)


def by_name(table: Table) -> dict[str, list[Row]]:
    """Group the rows of a result by the names of their tables, in order."""
    return {name: [row for row in table.rows if row.table == name] for name in dict.fromkeys(row.table for row in table.rows)}


def cells(row: Row) -> list[str]:
    """Texts of a row, in the order of `HEADERS`."""
    published = "" if row.published is None else f"{row.published:.4g}"
    return [row.case, row.subject, row.quantity, f"{row.value:.4g}", published, row.unit]
