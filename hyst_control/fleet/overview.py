"""A fleet seen as a whole: onsets, outlying units and how verdicts run over units and nights, as JSON and as a page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from hyst_control.files import write_json
from hyst_control.fleet.change_points import Onset, find_onsets
from hyst_control.fleet.outliers import Outlier, find_outliers
from hyst_control.fleet.results import DONE
from hyst_control.reporting.html_page import Page

Array = NDArray[np.float64]

SCHEMA = "hyst_control/fleet-overview"
NAMED = ("effect", "parameters", "ambiguous")
"""Verdicts with which a report's first effect counts."""
DRAWN = 8
"""Onsets that are drawn."""
LISTED = 200
"""Rows of a table of the page; the JSON document has all."""


@dataclass(frozen=True)
class Overview:
    """A fleet seen as a whole.

    Parameters
    ----------
    kind
        "identify", "validate" or "diagnose".
    units
        Names of the units (U,).
    moments
        Times of the nights (T,).
    series
        Values (U, T) by quantity, NaN where there is none.
    verdicts
        Verdicts (U, T) of a study of diagnoses, "" where there is none.
    onsets
        Units whose quantities changed.
    outliers
        Units apart from the others.
    """

    kind: str
    units: Sequence[str]
    moments: Array
    series: Mapping[str, Array]
    verdicts: NDArray[np.object_]
    onsets: Sequence[Onset]
    outliers: Sequence[Outlier]

    def document(self) -> dict[str, Any]:
        """Convert to JSON types."""
        return {
            "schema": SCHEMA,
            "version": 1,
            "kind": self.kind,
            "units": len(self.units),
            "nights": len(self.moments),
            "onsets": [asdict(onset) for onset in self.onsets],
            "outliers": [asdict(outlier) for outlier in self.outliers],
        }


def overview(kind: str, rows: Sequence[Mapping[str, Any]]) -> Overview:
    """Look at all records of a study together.

    Parameters
    ----------
    kind
        "identify", "validate" or "diagnose".
    rows
        Rows of the results.

    Returns
    -------
    Overview
        What they tell.
    """
    done = [row for row in rows if row["status"] == DONE and np.isfinite(row["moment"])]
    units = sorted({row["unit"] for row in done})
    moments = np.array(sorted({row["moment"] for row in done}))
    place = {unit: index for index, unit in enumerate(units)}
    shape = (len(units), len(moments))
    verdicts = np.full(shape, "", dtype=object)
    named = Counter(name for row in done for name in _quantities(kind, row))
    series = {name: np.full(shape, np.nan) for name in sorted(named)}
    for row in done:
        at = place[row["unit"]], int(np.searchsorted(moments, row["moment"]))
        if kind == "diagnose":
            verdicts[at] = row["verdict"]
            for name in series:
                series[name][at] = 0.0  # what no report names is not there
        for name, value in _quantities(kind, row).items():
            series[name][at] = value
    onsets = [onset for name, values in series.items() for onset in find_onsets(name, units, moments, values)]
    whole = {name: values for name, values in series.items() if np.isfinite(values).any(axis=1).all()}
    means = np.column_stack([np.nanmean(values, axis=1) for values in whole.values()]) if whole else np.zeros((len(units), 0))
    outliers = find_outliers(units, list(whole), means)
    return Overview(kind, units, moments, series, verdicts, sorted(onsets, key=lambda onset: -onset.probability), outliers)


def write_overview(found: Overview, rows: Sequence[Mapping[str, Any]], folder: Path) -> None:
    """Write `fleet.json` and `fleet.html`.

    Parameters
    ----------
    found
        The overview.
    rows
        Rows of the results.
    folder
        Folder of the study.
    """
    write_json(folder / "fleet.json", found.document())
    failed = [row for row in rows if row["status"] != DONE]
    summary = (
        f"{len(rows)} records of {len(found.units)} units in {len(found.moments)} nights: {len(found.onsets)} changes, "
        f"{len(found.outliers)} units apart from the others, {len(failed)} records that failed."
    )
    page = Page(f"Fleet: {found.kind}", summary)
    if found.kind == "diagnose" and len(found.units):
        page.section("Verdicts", "Every record, by unit and night.")
        page.figure(_verdict_map(found), max(320, min(900, 120 + 6 * len(found.units))))
    page.section(
        "Changes",
        "Units whose quantity changed, with the first night of the change; of the units named, 2 % at most are wrong on average.",
    )
    page.table(
        ("unit", "quantity", "probability", "first night", "90 % of it within", "change"),
        [
            (
                onset.unit,
                onset.quantity,
                f"{onset.probability:.4f}",
                f"{onset.moment:g}",
                f"{onset.earliest:g} to {onset.latest:g}",
                f"{onset.size:.4g} ± {onset.size_error:.2g}",
            )
            for onset in found.onsets[:LISTED]
        ],
    )
    for onset in found.onsets[:DRAWN]:
        page.figure(_course(found, onset), 260)
    page.section("Units apart from the others", "By the Mahalanobis distance of their means; the false discovery rate is 5 %.")
    page.table(
        ("unit", "distance", "adjusted p", "farthest quantity", "deviation"),
        [
            (each.unit, f"{each.distance:.1f}", f"{each.probability:.2g}", each.farthest, f"{each.deviation:+.1f} σ")
            for each in found.outliers[:LISTED]
        ],
    )
    page.section("Records that failed")
    page.table(
        ("unit", "time", "bag", "reason"), [(row["unit"], row["time"], row["bag"], row["reason"]) for row in failed[:LISTED]]
    )
    page.write(folder / "fleet.html")


def _quantities(kind: str, row: Mapping[str, Any]) -> dict[str, float]:
    """Numbers of a record that may change over nights."""
    if kind == "identify":
        return {each["name"]: each["value"] for each in row["parameters"] or []}
    if kind == "validate":
        return {f"nrmse {each['axis']}": each["nrmse"] for each in row["errors"] or []}
    found = {"gap_rms": row["gap_rms"]}
    if row["verdict"] in NAMED:
        for effect in row["effects"] or []:
            for parameter in (effect["parameters"] or [])[:1]:
                if parameter["value"] is not None:
                    found[f"{effect['name']}.{parameter['name']}"] = parameter["value"]
            if row["verdict"] == "ambiguous":
                break
    return found


def _verdict_map(found: Overview) -> go.Figure:
    names = sorted({str(verdict) for verdict in found.verdicts.ravel() if verdict})
    codes = np.array([[names.index(v) if v else np.nan for v in row] for row in found.verdicts], dtype=float)
    bar = {"tickvals": list(range(len(names))), "ticktext": names}
    figure = go.Figure(
        go.Heatmap(
            z=codes, x=found.moments, y=list(found.units), colorbar=bar, zmin=-0.5, zmax=len(names) - 0.5, colorscale="Viridis"
        )
    )
    figure.update_xaxes(title_text="night")
    figure.update_yaxes(title_text="unit")
    return figure


def _course(found: Overview, onset: Onset) -> go.Figure:
    values = found.series[onset.quantity]
    low, middle, high = np.nanpercentile(values, (5.0, 50.0, 95.0), axis=0)
    figure = go.Figure()
    figure.add_trace(go.Scatter(x=found.moments, y=high, line={"width": 0}, showlegend=False, hoverinfo="skip"))
    figure.add_trace(
        go.Scatter(
            x=found.moments, y=low, fill="tonexty", line={"width": 0}, name="90 % of all units", fillcolor="rgba(42,111,151,0.2)"
        )
    )
    figure.add_trace(go.Scatter(x=found.moments, y=middle, name="median of all units", line={"color": "#2a6f97"}))
    own = values[list(found.units).index(onset.unit)]
    figure.add_trace(go.Scatter(x=found.moments, y=own, name=onset.unit, mode="lines+markers", line={"color": "#c2542d"}))
    figure.add_vline(x=onset.moment, line_dash="dot")
    figure.update_xaxes(title_text="night")
    figure.update_yaxes(title_text=onset.quantity)
    return figure
