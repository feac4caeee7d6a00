# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""One zoomable page of an experiment: every quantity of its tables drawn beside the published values, and the numbers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import plotly.graph_objects as go
from plotly.subplots import make_subplots

from hyst_control.reporting.html_page import Page, Palette
from hyst_control.reporting.table_page import HEADERS, by_name, cells
from hyst_control.reporting.tables import Row, Table

HEIGHT = 260
"""Of a quantity's panel, px."""


def write_page(folder: str | Path, table: Table) -> None:
    """Write the page of a result, NAME.html, to a folder."""
    name = table.source.split()[-1]
    page = Page(
        f"hyst {table.source}", "Measured values as bars, published ones as marks. The complete rows are below each figure."
    )
    for title, rows in by_name(table).items():
        page.section(title)
        quantities = list(dict.fromkeys((row.quantity, row.unit) for row in rows))
        page.figure(drawing(rows, quantities), HEIGHT * len(quantities) + 100)
        page.table(HEADERS, [cells(row) for row in rows])
    for note in table.notes:
        page.note(note)
    Path(folder).mkdir(parents=True, exist_ok=True)
    page.write(Path(folder) / f"{name}.html")


def drawing(rows: Sequence[Row], quantities: Sequence[tuple[str, str]]) -> go.Figure:
    """Draw each quantity over the cases: a bar for every subject, a mark where a value is published."""
    figure = make_subplots(rows=len(quantities), cols=1, subplot_titles=[f"{name} [{unit}]" for name, unit in quantities])
    palette = Palette(*(row.subject for row in rows))
    for panel, quantity in enumerate(quantities, start=1):
        own = [row for row in rows if (row.quantity, row.unit) == quantity]
        for subject in dict.fromkeys(row.subject for row in own):
            mine = [row for row in own if row.subject == subject]
            first = next((row.quantity, row.unit) for row in rows if row.subject == subject) == quantity
            cases, color = [row.case for row in mine], palette.color(subject)
            look = {"name": subject, "legendgroup": subject, "offsetgroup": subject, "showlegend": first}
            figure.add_trace(go.Bar(x=cases, y=[row.value for row in mine], marker={"color": color}, **look), panel, 1)
            if known := [row for row in mine if row.published is not None]:
                mark = {"mode": "markers", "marker": {"color": color, "symbol": "line-ew-open", "size": 14}, "showlegend": False}
                y = [row.published for row in known]
                figure.add_trace(go.Scatter(x=[row.case for row in known], y=y, name=f"{subject}, published", **mark), panel, 1)
    return figure
