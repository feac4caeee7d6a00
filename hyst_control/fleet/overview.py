# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A fleet seen as a whole: changes, drifts, common causes, outlying units, and how verdicts run over units and runs; as JSON."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.effects import EFFECTS
from hyst_control.fleet.change_points import Onset, Trend, find_changes, forecast
from hyst_control.fleet.common_causes import CommonCause, find_common_causes, shared_columns
from hyst_control.fleet.course_fit import successive_differences
from hyst_control.fleet.covariates import CovariateEffect, take_out
from hyst_control.fleet.manifest import is_date
from hyst_control.fleet.outliers import Outlier, find_outliers
from hyst_control.fleet.record_jobs import NO_GAP, OPEN
from hyst_control.fleet.results import DONE

SCHEMA = "hyst_control/fleet-overview"
GAP = "gap_rms"  # Quantity that every diagnosed record has
NAMED = ("effect", "parameters", "ambiguous")  # Verdicts with which effects of a report count
LATEST = 2.5e11  # s since 1970, shortly before the end of the calendar: a later date is shown as this one


@dataclass(frozen=True)
class Overview:
    """A fleet seen as a whole."""

    kind: str  # "identify", "validate" or "diagnose"
    units: Sequence[str]  # Names of the units (U,)
    moments: Annotated[Array, "T"]  # Times of the runs (T,)
    series: Mapping[str, Array]  # Values (U, T) by quantity, NaN where there is none
    verdicts: NDArray[np.object_]  # Verdicts (U, T) of a study of diagnoses, "" where there is none
    pages: NDArray[np.object_]  # Paths (U, T) of the records' own pages, "" where there is none
    onsets: Sequence[Onset]  # Units whose quantities shifted
    trends: Sequence[Trend]  # Units whose quantities drift
    causes: Sequence[CommonCause]  # What units that changed have in common
    covariates: Sequence[CovariateEffect]  # Influences that were taken out of the quantities
    outliers: Sequence[Outlier]  # Units apart from the others
    dated: bool = False  # Whether the times are dates, and the moments seconds since 1970

    def dates(self, moments: Iterable[float]) -> list[float | datetime]:
        """Moments as the manifest has times: dates, or the numbers themselves."""
        return [datetime.fromtimestamp(min(moment, LATEST)) if self.dated else float(moment) for moment in moments]

    def time(self, moment: float) -> str:
        """Text of a moment; midnight is left out of a date."""
        [shown] = self.dates([moment])
        return f"{shown:g}" if isinstance(shown, float) else f"{shown:%Y-%m-%d %H:%M:%S}".removesuffix(" 00:00:00")

    def document(self) -> dict[str, Any]:
        """Convert to JSON types."""
        return {
            "schema": SCHEMA,
            "version": 1,
            "kind": self.kind,
            "units": len(self.units),
            "runs": len(self.moments),
            "onsets": [asdict(onset) for onset in self.onsets],
            "trends": [asdict(trend) for trend in self.trends],
            "common_causes": [asdict(cause) for cause in self.causes],
            "covariates": [asdict(effect) for effect in self.covariates],
            "outliers": [asdict(outlier) for outlier in self.outliers],
        }


def overview(
    kind: str, rows: Sequence[Mapping[str, Any]], columns: Sequence[str] = (), limits: Mapping[str, float] | None = None
) -> Overview:
    """Look at all records of a study together."""
    # columns: further columns of the manifest: numbers that differ within a unit are covariates, values that belong to a unit may
    # be what units that changed have in common
    done = [row for row in rows if row["status"] == DONE and np.isfinite(row["moment"])]
    units = sorted({row["unit"] for row in done})
    moments = np.array(sorted({row["moment"] for row in done}))
    shape = (len(units), len(moments))
    place = {unit: index for index, unit in enumerate(units)}
    cells = [(place[row["unit"]], int(np.searchsorted(moments, row["moment"]))) for row in done]
    verdicts, pages = np.full(shape, "", dtype=object), np.full(shape, "", dtype=object)
    for at, row in zip(cells, done, strict=True):
        verdicts[at] = row.get("verdict") or ""
        pages[at] = row.get("page_file") or ""
    series = _series(kind, done, cells, shape)
    covariates = _covariates(done, cells, shape, columns)
    onsets: list[Onset] = []
    trends: list[Trend] = []
    influences: list[CovariateEffect] = []
    for name, values in series.items():
        known = {**covariates, **_distances(covariates, done, cells)} if name == GAP else covariates
        series[name], believed = take_out(name, values, known)
        influences += believed
        shifted, drifting = find_changes(name, units, moments, series[name])
        if name == GAP:
            shifted = [onset for onset in shifted if _matters(verdicts[place[onset.unit], moments >= onset.moment])]
            drifting = [trend for trend in drifting if _matters(verdicts[place[trend.unit], moments >= trend.last])]
        onsets += shifted
        trends += [forecast(trend, limits or {}) for trend in drifting]
    changed: dict[str, dict[str, float]] = {}
    for onset in onsets:
        changed.setdefault(onset.quantity, {})[onset.unit] = onset.moment
    causes = find_common_causes(changed, shared_columns(done, columns), len(units), len(moments))
    whole = {name: values for name, values in series.items() if np.isfinite(values).any(axis=1).all()}
    means = np.column_stack([np.nanmean(values, axis=1) for values in whole.values()]) if whole else np.zeros((len(units), 0))
    onsets.sort(key=lambda onset: -onset.probability)
    trends.sort(key=lambda trend: -trend.probability)
    outliers = find_outliers(units, list(whole), means)
    dated = any(is_date(row["time"]) for row in done)
    return Overview(kind, units, moments, series, verdicts, pages, onsets, trends, causes, influences, outliers, dated)


def check_limits(kind: str, limits: Mapping[str, float]) -> None:
    """Refuse a limit of a quantity that no study of this kind has."""
    # which coefficients a model has and which sizes an effect, only the records say
    pattern, words = {
        "identify": (r"\d+\..+", "INDEX.STAGE.COEFFICIENT of the models, as 0.delay.tau"),
        "validate": (r"nrmse .+", "'nrmse AXIS', as 'nrmse x'"),
        "diagnose": (rf"{GAP}|({'|'.join(EFFECTS)})\..+", f"{GAP}, or EFFECT.SIZE, as gain.gain, of {', '.join(EFFECTS)}"),
    }[kind]
    for name in limits:
        if not re.fullmatch(pattern, name):
            raise InputError(f"--limit {name}: is no quantity that {kind} finds: give {words}")


def _matters(verdicts: NDArray[np.object_]) -> bool:
    """True unless every record that was diagnosed since a change has no gap: the change is below the practical size then."""
    known = [verdict for verdict in verdicts if verdict not in ("", OPEN)]
    return not known or any(verdict != NO_GAP for verdict in known)


def _series(
    kind: str, rows: Sequence[Mapping[str, Any]], cells: Sequence[tuple[int, int]], shape: tuple[int, int]
) -> dict[str, Array]:
    """Values (U, T) by quantity."""
    compared = {row["unit"] for row in rows if row.get("baseline")}
    believed: Counter[tuple[str, str]] = Counter()  # Sums of the probabilities by unit and effect
    for row in rows:
        for effect in row.get("effects") or []:
            believed[row["unit"], effect["name"]] += effect["probability"]
    found = [_quantities(kind, row, row["unit"] in compared, believed) for row in rows]
    series = {name: np.full(shape, np.nan) for name in sorted({name for numbers in found for name in numbers})}
    for at, row, numbers in zip(cells, rows, found, strict=True):
        if kind == "diagnose" and row["verdict"] != OPEN:
            for name in series:
                if name != GAP:
                    series[name][at] = 0.0  # what no report names is not there
        for name, value in numbers.items():
            series[name][at] = value
    return series


def _covariates(
    rows: Sequence[Mapping[str, Any]], cells: Sequence[tuple[int, int]], shape: tuple[int, int], columns: Sequence[str]
) -> dict[str, Array]:
    """Columns of the manifest that are numbers, (U, T); those that belong to a unit say nothing of its runs."""
    found: dict[str, Array] = {}
    for name in columns:
        values = np.full(shape, np.nan)
        try:
            for at, row in zip(cells, rows, strict=True):
                values[at] = float(row.get(name) or "nan")
        except ValueError:
            continue
        if np.any(successive_differences(values)[0] != 0.0):
            found[name] = values
    return found


def _distances(
    covariates: Mapping[str, Array], rows: Sequence[Mapping[str, Any]], cells: Sequence[tuple[int, int]]
) -> dict[str, Array]:
    """Distances (U, T) of the covariates from those of the baseline records: a gap to these grows either way."""
    compared = {row["unit"] for row in rows if row.get("baseline")}
    clean = [at for at, row in zip(cells, rows, strict=True) if row["unit"] in compared and not row.get("baseline")]
    found: dict[str, Array] = {}
    for name, values in covariates.items() if clean else ():
        at_clean = np.full(values.shape, np.nan)
        at_clean[tuple(np.transpose(clean))] = values[tuple(np.transpose(clean))]
        count = np.isfinite(at_clean).sum(axis=1)
        center = np.nansum(at_clean, axis=1) / np.where(count, count, np.nan)
        found[f"{name}, distance from the baseline records"] = np.abs(values - center[:, None])
    return found


def _quantities(kind: str, row: Mapping[str, Any], compared: bool, believed: Mapping[tuple[str, str], float]) -> dict[str, float]:
    """Numbers of a record that may change over runs; a gap to the model is none to the baseline records with which others are compared."""
    if kind == "identify":
        return {each["name"]: each["value"] for each in row["parameters"] or []}
    if kind == "validate":
        return {f"nrmse {each['axis']}": each["nrmse"] for each in row["errors"] or []}
    comparable = bool(row.get("baseline")) or not compared
    found = {GAP: row[GAP]} if comparable else {}
    if row["verdict"] in NAMED:
        effects = row["effects"] or []
        if row["verdict"] == "ambiguous":
            # Of the alternatives the most probable one in all reports of the unit: the first one may differ from run to run.
            effects = sorted(effects, key=lambda effect: -believed[row["unit"], effect["name"]])[:1]
        for effect in effects:
            for parameter in (effect["parameters"] or [])[:1]:
                if parameter["value"] is not None:
                    found[f"{effect['name']}.{parameter['name']}"] = parameter["value"]
    return found
