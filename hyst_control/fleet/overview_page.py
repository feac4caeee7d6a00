# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The page of a fleet: verdicts, changes, drifts, common causes and outlying units; a click leads to a record's own page."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
import plotly.graph_objects as go
from markupsafe import Markup

from hyst_control.base.files import write_json
from hyst_control.fleet.change_points import Trend
from hyst_control.fleet.common_causes import FIRST_RUN, CommonCause
from hyst_control.fleet.overview import Overview
from hyst_control.fleet.results import DONE
from hyst_control.reporting.html_page import BAND, COLORS, Page

DRAWN = 8  # Changes and drifts that are drawn
LISTED = 200  # Rows of a table of the page; the JSON document has all
VERDICT_COLORS = {"no_gap": "#5b8e3e", "parameters": "#2a6f97", "effect": "#c2542d", "ambiguous": "#b08a1e", "unknown": "#8a5aa8"}
OTHER = "#8a93a1"
"""Color of a cell, by verdict; of any other verdict."""
DAY = 86400.0  # s
SHOWN_UNITS = 8  # Units that a common cause names


def write_overview(found: Overview, rows: Sequence[Mapping[str, Any]], folder: Path) -> None:
    """Write `fleet.json` and `fleet.html`."""
    write_json(folder / "fleet.json", found.document())
    failed = [row for row in rows if row["status"] != DONE]
    summary = (
        f"{len(rows)} records of {len(found.units)} units in {len(found.moments)} runs: {len(found.onsets)} changes, "
        f"{len(found.trends)} drifts, {len(found.causes)} common causes, {len(found.outliers)} units apart from the others, "
        f"{len(failed)} records that failed."
    )
    page = Page(f"Fleet: {found.kind}", summary)
    links = _Links(found, folder)
    if found.kind == "diagnose" and len(found.units):
        page.section("Verdicts", "Every record, by unit and run. A click opens the record's own page, where it has one.")
        page.figure(_verdict_map(found, links), max(320, min(900, 120 + 6 * len(found.units))))
    _listed(
        page,
        "Common causes",
        "What more units that changed share than chance would have; of those listed, 1 % at most are wrong on average.",
        ("quantity", "in common", "units that changed", "of", "adjusted p"),
        [_cause_row(cause, found) for cause in found.causes],
    )
    _listed(
        page,
        "Changes",
        "Units whose quantity shifted, with the first run of the shift; of the units named here and below, 2 % at most are wrong on "
        "average.",
        ("unit", "quantity", "probability", "first run", "90 % of it within", "change"),
        [
            (
                links.to(onset.unit, onset.moment),
                onset.quantity,
                f"{onset.probability:.4f}",
                found.time(onset.moment),
                f"{found.time(onset.earliest)} to {found.time(onset.latest)}",
                f"{onset.size:.4g} ± {onset.size_error:.2g}",
            )
            for onset in found.onsets[:LISTED]
        ],
    )
    for onset in found.onsets[:DRAWN]:
        figure = _course(found, onset.unit, onset.quantity, links)
        figure.add_vline(x=found.dates([onset.moment])[0], line_dash="dot")
        page.figure(figure, 260)
    _listed(
        page,
        "Drifts",
        "Units whose quantity moves steadily, and when it will be at its limit where one was given.",
        ("unit", "quantity", "probability", "per day" if found.dated else "per unit of time", "at its limit", "90 % of it within"),
        [_trend_row(trend, found, links) for trend in found.trends[:LISTED]],
    )
    for trend in found.trends[:DRAWN]:
        page.figure(_forecast(found, trend, links), 260)
    _listed(
        page,
        "Covariates",
        "Taken out before changes were looked for.",
        ("quantity", "covariate", "slope"),
        [(each.quantity, each.covariate, f"{each.slope:.4g} ± {each.slope_error:.2g}") for each in found.covariates[:LISTED]],
    )
    _listed(
        page,
        "Units apart from the others",
        "By the Mahalanobis distance of their means; the false discovery rate is 5 %.",
        ("unit", "distance", "adjusted p", "farthest quantity", "deviation"),
        [
            (each.unit, f"{each.distance:.1f}", f"{each.probability:.2g}", each.farthest, f"{each.deviation:+.1f} σ")
            for each in found.outliers[:LISTED]
        ],
    )
    _listed(
        page,
        "Records that failed",
        "",
        ("unit", "time", "bag", "reason"),
        [(row["unit"], row["time"], row["bag"], row["reason"]) for row in failed[:LISTED]],
    )
    page.write(folder / "fleet.html")


def _listed(page: Page, heading: str, text: str, headers: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A section with a table, where there is a row."""
    if rows:
        page.section(heading, text)
        page.table(headers, rows)


class _Links:
    """Links from the fleet's page to those of the records, relative to the study's folder."""

    def __init__(self, found: Overview, folder: Path) -> None:
        self._found = found
        self.paths = np.array(
            [[quote(os.path.relpath(page, folder)) if page else "" for page in row] for row in found.pages], dtype=object
        ).reshape(found.pages.shape)

    def of(self, unit: str) -> list[str]:
        """Links of a unit's runs."""
        return list(self.paths[list(self._found.units).index(unit)])

    def to(self, unit: str, moment: float) -> str:
        """Name of a unit, leading to its record of a run where that has a page."""
        link = self.of(unit)[int(np.searchsorted(self._found.moments, moment))]
        return Markup("<a href='{}'>{}</a>").format(link, unit) if link else unit


def _cause_row(cause: CommonCause, found: Overview) -> tuple[str, ...]:
    named = ", ".join(cause.changed[:SHOWN_UNITS]) + (", …" if len(cause.changed) > SHOWN_UNITS else "")
    value = found.time(float(cause.value)) if cause.column == FIRST_RUN else cause.value
    return (
        cause.quantity,
        f"{cause.column} {value}",
        f"{len(cause.changed)}: {named}",
        str(cause.of),
        f"{cause.probability:.2g}",
    )


def _trend_row(trend: Trend, found: Overview, links: _Links) -> tuple[str, ...]:
    ends = [found.time(end) if end is not None else "never" for end in (trend.earliest, trend.latest)]
    time = DAY if found.dated else 1.0
    return (
        links.to(trend.unit, trend.last),
        trend.quantity,
        f"{trend.probability:.4f}",
        f"{time * trend.slope:.4g} ± {time * trend.slope_error:.2g}",
        "" if trend.crossing is None else found.time(trend.crossing),
        "" if trend.crossing is None else " to ".join(ends),
    )


def _verdict_map(found: Overview, links: _Links) -> go.Figure:
    names = sorted({str(verdict) for verdict in found.verdicts.ravel() if verdict})
    codes = np.array([[names.index(v) if v else np.nan for v in row] for row in found.verdicts], dtype=float)
    bar = {"tickvals": list(range(len(names))), "ticktext": [name.replace("_", " ") for name in names]}
    steps = [[(index + end) / len(names), VERDICT_COLORS.get(name, OTHER)] for index, name in enumerate(names) for end in (0, 1)]
    figure = go.Figure()
    colors = {"colorbar": bar, "zmin": -0.5, "zmax": len(names) - 0.5, "colorscale": steps, "xgap": 1, "ygap": 1}
    figure.add_heatmap(z=codes, x=found.dates(found.moments), y=list(found.units), customdata=links.paths, **colors)
    figure.update_xaxes(title_text="run")
    figure.update_yaxes(title_text="unit")
    return figure


def _course(found: Overview, unit: str, quantity: str, links: _Links) -> go.Figure:
    """A quantity of one unit before those of all."""
    values = found.series[quantity]
    there = np.isfinite(values).any(axis=0)
    runs = found.dates(found.moments[there])
    low, middle, high = np.nanpercentile(values[:, there], (5.0, 50.0, 95.0), axis=0)
    figure = go.Figure()
    figure.add_trace(go.Scatter(x=runs, y=high, line={"width": 0}, showlegend=False, hoverinfo="skip"))
    figure.add_trace(go.Scatter(x=runs, y=low, fill="tonexty", line={"width": 0}, name="90 % of all units", fillcolor=BAND))
    figure.add_trace(go.Scatter(x=runs, y=middle, name="median of all units", line={"color": COLORS[2]}))
    own, line = values[list(found.units).index(unit)], {"color": COLORS[1]}
    figure.add_trace(
        go.Scatter(x=found.dates(found.moments), y=own, customdata=links.of(unit), name=unit, mode="lines+markers", line=line)
    )
    figure.update_xaxes(title_text="run")
    figure.update_yaxes(title_text=quantity)
    return figure


def _forecast(found: Overview, trend: Trend, links: _Links) -> go.Figure:
    """A drifting quantity, its trend, and the limit that it will reach."""
    figure = _course(found, trend.unit, trend.quantity, links)
    first = float(found.moments[0])
    last = trend.last if trend.crossing is None else trend.crossing
    ends = np.array([first, last])
    line = {"color": COLORS[1], "dash": "dot"}
    level = trend.level + trend.slope * (ends - trend.last)
    figure.add_trace(go.Scatter(x=found.dates(ends), y=level, name="trend", mode="lines", line=line))
    if trend.crossing is not None:
        figure.add_hline(y=trend.level + trend.slope * (trend.crossing - trend.last), line_dash="dash")
    return figure
