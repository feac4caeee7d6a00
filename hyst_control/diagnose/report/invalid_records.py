# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The gap report of records that are no measurement of their command: nothing is diagnosed, and the reason named."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hyst_control.base.errors import InputError
from hyst_control.identify.trial_beside_model import trial_beside
from hyst_control.model_file import Model
from hyst_control.records.record import Record
from hyst_control.records.validity.checks import examined
from hyst_control.records.validity.findings import Finding, Trial
from hyst_control.records.validity.time_shift import clock_beside_model
from hyst_control.reporting.provenance import Origin

INVALID_RECORD = "invalid_record"  # First of the report's reasons; the findings' names follow it


def invalid_report(records: Sequence[Record], model: Model) -> tuple[tuple[dict[str, Any], str] | None, list[str]]:
    """Report on records that show something else than the plant's answer to the command, None where they do not, and further notes."""
    trials = trials_of(records, model)
    found, remarks = examined(trials)
    if not found:
        found = [each for trial in trials for index in range(len(trial.axes)) for each in clock_beside_model(trial, index)]
    notes = [each.text() for each in remarks if not any(each.name == other.name for other in found)]
    if not found:
        return None, notes
    words = ["The record is no measurement of its command, and is not diagnosed:", *(f"  {each.text()}" for each in found)]
    return (_document(trials, model, found), "\n".join(words)), notes


def trials_of(records: Sequence[Record], model: Model) -> list[Trial]:
    """Gapless stretches of records with what the model makes of their commands; none where a record does not fit the model."""
    trials = []
    for record in records:
        try:
            for part in record.aligned(allow_gaps=True):
                command, measurement = part.command, part.measurement
                if not command.shape[1] == measurement.shape[1] == len(model.axes):
                    return []
                trials.append(trial_beside(model, part.source, command, measurement, record.sample_time, record.hold))
        except InputError:
            return []
    return trials


def _document(trials: Sequence[Trial], model: Model, found: Sequence[Finding]) -> dict[str, Any]:
    """Every field of a gap report; those that only a diagnosis fills are empty."""
    simulated = [(trial.measurement, trial.simulated) for trial in trials if trial.simulated is not None]
    gap: dict[str, Any] = {"rms": None, "nrmse": None}
    if simulated:
        rows = np.concatenate([measured - modeled for measured, modeled in simulated])
        spans = np.ptp(np.concatenate([measured for measured, _ in simulated]), axis=0)
        energies = np.mean(rows**2, axis=0)
        gap["rms"] = float(np.sqrt(np.mean(energies)))
        gap["nrmse"] = float(np.mean(100.0 * np.sqrt(energies) / spans)) if np.all(spans > 0) else None
    sigma = np.asarray(model.noise.get("sigma", 0.0), dtype=float)
    return {
        "schema": "hyst_control/gap-report",
        "version": 1,
        "verdict": "unknown",
        "reasons": [INVALID_RECORD, *dict.fromkeys(finding.name for finding in found)],
        "gap": {
            **gap,
            "nrmse_unit": "% of range",
            "floor_rms": float(np.sqrt(np.mean(sigma**2))),
            "unit": model.units["measurement"],
        },
        "where": {"stage": [], "kind": [], "band": [], "amplitude": [], "axis": [], "time": []},
        "effects": [],
        "candidates": [],
        "parameters": [],
        "next_experiment": None,
        "augmented_model": None,
        "unexplained_share": 1.0,
        "replay": [],
        "invalid_records": [finding.document() for finding in found],
        "notes": [finding.text() for finding in found],
    }


def write_invalid_page(path: Path, document: dict[str, Any], origins: Sequence[Origin]) -> None:
    """Write the report's page on records that are not diagnosed."""
    from hyst_control.reporting.html_page import Page

    page = Page("Gap report", "The record is no measurement of its command, and is not diagnosed.", origins)
    page.section("Findings")
    page.table(
        ["record", "axis", "finding", "value", "limit"],
        [
            [row["record"], row["axis"], row["name"].replace("_", " "), f"{row['value']:.3g}", f"{row['limit']:.3g}"]
            for row in document["invalid_records"]
        ],
    )
    for line in document["notes"]:
        page.note(line)
    page.write(path)
