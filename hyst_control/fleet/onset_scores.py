# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Scores of a study of a simulated fleet: which changes were found, against the fleet's labels."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hyst_control.base.errors import InputError
from hyst_control.reporting.tables import Table

NEAR = 1.0  # Runs by which an onset may be off


def score_study(study: str | Path, labels: str | Path) -> Table:
    """Compare a study's changes with the labels of its fleet; a unit's run is that of its most probable shift."""
    found = _document(Path(study) / "fleet.json", ("onsets", "trends", "common_causes"))
    truth = _document(Path(labels), ("units", "runs", "driver"))
    shared = truth["driver"]
    try:
        begins = {unit["name"]: float(unit["begins"]) for unit in truth["units"] if unit["effect"]}
        driver, effect = ("", "") if shared is None else (str(shared["driver"]), str(shared["effect"]))
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{labels}: holds no labels of a fleet ({error!r}): give the file that hyst cases make --fleet wrote"
        ) from None
    named: dict[str, float | None] = {}
    for claim in sorted([*found["onsets"], *found["trends"]], key=lambda claim: -claim["probability"]):
        if named.get(claim["unit"]) is None:
            named[claim["unit"]] = claim.get("moment")
    right = [unit for unit in named if unit in begins]
    runs = [moment for unit in right if (moment := named[unit]) is not None and abs(moment - begins[unit]) <= NEAR]
    table = Table("fleet score")
    count = len(truth["units"])
    for quantity, part, whole in (
        ("precision", len(right), len(named)),
        ("recall", len(right), len(begins)),
        (f"run within {NEAR:g}", len(runs), len(right)),
    ):
        if whole:
            table.add(
                "onsets", f"{count} units, {truth['runs']} runs", "units with an effect", quantity, "1", part / whole, n=whole
            )
    if driver:
        causes = {(cause["column"], cause["value"]) for cause in found["common_causes"]}
        hit = ("driver", driver) in causes
        table.add("common causes", driver, effect, "driver named", "1", float(hit))
        others = sum(column == "driver" for column, _ in causes) - hit
        table.add("common causes", "all", "all", "other drivers named", "1", float(others))
    if not table.rows:
        table.notes.append(f"{labels}: nothing to score: no effect begins in this fleet, and none was found")
    return table


def _document(path: Path, keys: tuple[str, ...]) -> Mapping[str, Any]:
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be read ({error}): give the study of a fleet and its labels") from None
    if not isinstance(found, dict) or any(key not in found for key in keys):
        raise InputError(f"{path}: has no {', '.join(keys)}: give the study of a fleet and its labels")
    return found
