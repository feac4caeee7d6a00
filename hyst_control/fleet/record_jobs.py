# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Computation of one record of a fleet: a row of results from a bag, its model and its baseline records, without anything else."""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hyst_control.fleet.manifest import Entry

if TYPE_CHECKING:
    from hyst_control.model_file import Model
    from hyst_control.records.record import Record

GAPS, ONSETS = "gaps", "onsets"
"""Values of the option `only` of diagnoses: of records with a gap, or of the clearest record of every unit that changed."""
NO_GAP, OPEN = "no_gap", "not_diagnosed"  # Verdicts of records of which no effect was tried


@dataclass(frozen=True)
class RecordJob:
    """One record to compute."""

    kind: str  # Key of `KINDS`
    entry: Entry  # The record
    options: Mapping[str, Any]  # Of `identify_bags`, `validate_bags` or `diagnose_bags`; of the latter also `pages` and `only`
    folder: str  # Folder of the study, for models that are written


def compute(job: RecordJob) -> dict[str, Any]:
    """Compute a record's own columns."""
    begin = time.perf_counter()
    values = KINDS[job.kind](job)
    return {**values, "seconds": time.perf_counter() - begin}


def mark(job: RecordJob, version: str) -> str:
    """Fingerprint of all that a record's result depends on: if it is the same, the result is."""
    digest = hashlib.sha256(repr((job.kind, sorted(job.options.items()), version)).encode())
    for path in (job.entry.bag, *job.entry.baseline):
        digest.update(bag_stamp(path).encode())
    if job.entry.model:
        digest.update(Path(job.entry.model).read_bytes())
    return digest.hexdigest()


def _own_file(job: RecordJob, kind: str, ending: str) -> Path:
    """File of a record in a folder of the study, named by unit and time for people and by the bag to be its own."""
    name = "".join(letter if letter.isalnum() or letter in "-_." else "_" for letter in f"{job.entry.unit}_{job.entry.time}")
    folder = Path(job.folder) / kind
    folder.mkdir(exist_ok=True)
    return folder / f"{name}_{hashlib.sha256(job.entry.bag.encode()).hexdigest()[:8]}{ending}"


def bag_stamp(bag: str) -> str:
    """Names, sizes and times of change of a bag's files: another text where the bag is another one. Raises `OSError`."""
    path = Path(bag)
    files = sorted(each for each in path.rglob("*") if each.is_file()) if path.is_dir() else [path]
    return "".join(repr((file.name, found.st_size, found.st_mtime_ns)) for file in files for found in [os.stat(file)])


def _identify(job: RecordJob) -> dict[str, Any]:
    from hyst_control.identify.workflow import identify_bags
    from hyst_control.model_file import model_to_document

    output = _own_file(job, "models", ".yaml")
    options = {"family": None, **job.options}
    result = identify_bags([job.entry.bag], options.pop("family"), output, **options)
    stages = model_to_document(result.fit.model)["chain"]
    parameters = [
        {"name": f"{index}.{stage['stage']}.{name}", "value": value}
        for index, stage in enumerate(stages)
        for name, value in _numbers({key: value for key, value in stage.items() if key != "stage"})
    ]
    return {
        "family": str(result.fit.report.get("family", "")),
        "model_file": str(result.written()),
        "held_out_nrmse": [float(value) for value in result.fit.report.get("held_out_nrmse", ())],
        "parameters": parameters,
    }


def _numbers(value: Any, name: str = "") -> list[tuple[str, float]]:
    """Numbers within nested mappings and lists, with their paths."""
    if isinstance(value, bool) or value is None or isinstance(value, str):
        return []
    if isinstance(value, (int, float)):
        return [(name, float(value))]
    if isinstance(value, Mapping):
        return [found for key, each in value.items() for found in _numbers(each, f"{name}.{key}" if name else str(key))]
    return [found for index, each in enumerate(value) for found in _numbers(each, f"{name}[{index}]")]


def _validate(job: RecordJob) -> dict[str, Any]:
    from hyst_control.identify.validation import validate_bags

    table = validate_bags([job.entry.model], [job.entry.bag], "fleet validate", **job.options)
    axes = _model(job.entry.model, bag_stamp(job.entry.model)).axes
    errors: dict[str, dict[str, Any]] = {}
    for row in table.rows:
        if row.table == "validation" and row.quantity in ("nrmse", "nrmse_centered", "nme", "rmse"):
            # A record of one axis is named without it.
            axis = row.case.rpartition(" ")[2] if len(axes) > 1 else axes[0]
            errors.setdefault(row.case, {"axis": axis})[row.quantity] = row.value
    return {"errors": list(errors.values())}


def _screened(job: RecordJob, verdict: bool) -> dict[str, Any] | None:
    """Results of a record without trying any effect; None for one that shows something else than the plant's answer."""
    from hyst_control.diagnose.live.screening import screen
    from hyst_control.diagnose.report.invalid_records import invalid_report
    from hyst_control.records.bags.bag_reader import read_bag

    entry = job.entry
    where = (job.options.get("namespace"), job.options.get("unit", "unknown"))
    records = [read_bag(entry.bag, *where)]
    model = _model(entry.model, bag_stamp(entry.model)) if entry.model else None
    if model is not None and invalid_report(records, model)[0] is not None:
        return None
    found = screen(records, model, [_clean(bag, bag_stamp(bag), *where) for bag in entry.baseline], verdict)
    sizes = {name: getattr(found, name) for name in ("gap_rms", "gap_nrmse", "floor_rms", "left_rms")}
    nothing: dict[str, Any] = {"reasons": [], "effects": [], "deviations": []}
    return {"verdict": NO_GAP if found.no_gap else OPEN, **sizes, "measurement_unit": found.unit, **nothing}


@lru_cache(maxsize=16)
def _model(path: str, stamp: str) -> Model:
    from hyst_control.model_file import load_model

    return load_model(path)


@lru_cache(maxsize=16)
def _clean(bag: str, stamp: str, namespace: str | None, unit: str) -> Record:
    """A baseline record, which all runs of a unit share."""
    from hyst_control.records.bags.bag_reader import read_bag

    return read_bag(bag, namespace, unit)


def _diagnose(job: RecordJob) -> dict[str, Any]:
    import json

    from hyst_control.diagnose.workflow import diagnose_bags

    options = dict(job.options)
    only = options.pop("only", None)
    short = None if only is None else _screened(job, only == GAPS)
    if short is not None and (only == ONSETS or short["verdict"] == NO_GAP):
        return short
    path = _own_file(job, "reports", ".json")
    page = path.with_suffix(".html") if options.pop("pages", False) else None
    model = job.entry.model or None
    diagnose_bags(
        [job.entry.bag], model, json=str(path), report=None if page is None else str(page), baseline=job.entry.baseline, **options
    )
    report = json.loads(path.read_text(encoding="utf-8"))
    if page is not None and report["verdict"] == "no_gap":
        page.unlink()
        page = None
    return {
        "report_file": str(path),
        "page_file": page and str(page),
        "verdict": report["verdict"],
        "reasons": [str(reason) for reason in report.get("reasons", [])],
        "gap_rms": report["gap"]["rms"],
        "gap_nrmse": report["gap"]["nrmse"],
        "floor_rms": report["gap"]["floor_rms"],
        "left_rms": None if short is None else short["left_rms"],
        "measurement_unit": report["gap"]["unit"],
        "effects": [
            {
                "name": effect["name"],
                "probability": effect["probability"],
                "shrink": effect["shrink"],
                "parameters": [_parameter(name, value) for name, value in effect["parameters"].items()],
            }
            for effect in report["effects"]
        ],
        "deviations": [{"name": each["name"], "z": each["z"]} for each in report["parameters"]],
    }


def _parameter(name: str, value: Mapping[str, Any]) -> dict[str, Any]:
    def first(number: Any) -> float | None:
        """A number, or the first axis' one."""
        found = number[0] if isinstance(number, list) and number else number
        return float(found) if isinstance(found, (int, float)) else None

    low, high = value["ci90"] if value.get("ci90") else (None, None)
    return {"name": name, "value": first(value["value"]), "low": first(low), "high": first(high), "unit": value.get("unit", "")}


KINDS: dict[str, Callable[[RecordJob], dict[str, Any]]] = {"identify": _identify, "validate": _validate, "diagnose": _diagnose}
"""Computations by the name of the study."""
