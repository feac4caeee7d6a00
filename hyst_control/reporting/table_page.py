"""A result table in a report page and as Markdown: every row with the published value beside it."""

from __future__ import annotations

from hyst_control.reporting.html_page import Page
from hyst_control.reporting.tables import Row, Table

HEADERS = ("case", "subject", "quantity", "measured", "published", "unit")


def add_tables(page: Page, table: Table) -> None:
    """One section for each table."""
    for name, rows in by_name(table).items():
        page.section(name)
        page.table(HEADERS, [cells(row) for row in rows])


def markdown(table: Table) -> str:
    """The tables as Markdown."""
    lines: list[str] = []
    for name, rows in by_name(table).items():
        lines += [f"### {name}", "", f"| {' | '.join(HEADERS)} |", "|---|---|---|---:|---:|---|"]
        lines += [f"| {' | '.join(cells(row))} |" for row in rows] + [""]
    return "\n".join(lines)


def by_name(table: Table) -> dict[str, list[Row]]:
    """The rows under the names of their tables, in order."""
    return {name: [row for row in table.rows if row.table == name] for name in dict.fromkeys(row.table for row in table.rows)}


def cells(row: Row) -> list[str]:
    """A row's texts."""
    return [
        row.case,
        row.subject,
        row.quantity,
        f"{row.value:.4g}",
        "" if row.published is None else f"{row.published:.4g}",
        row.unit,
    ]
