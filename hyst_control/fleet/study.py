# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Studies: every record of a manifest identified, validated or diagnosed, on as many workers as there are, and continued after a stop.

A record whose mark (`record_jobs.mark`) is in the results already is not computed again; one that failed is tried again.
"""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from hyst_control.base.errors import InputError
from hyst_control.base.files import read_json, write_json
from hyst_control.base.installed import installed_version
from hyst_control.base.parallel import Workers, outcomes
from hyst_control.fleet.manifest import Entry
from hyst_control.fleet.overview import Overview, overview
from hyst_control.fleet.overview_page import write_overview
from hyst_control.fleet.record_jobs import GAPS, KINDS, ONSETS, OPEN, RecordJob, compute, mark
from hyst_control.fleet.results import DONE, FAILED, OTHERS, Results, schema
from hyst_control.fleet.split_axes import split_axes

SCHEMA = "hyst_control/fleet"
SUMMARY = "summary.json"
MAX_NAMED = 10


@dataclass(frozen=True)
class Study:
    """Result of a run of a study."""

    kind: str  # "identify", "validate" or "diagnose"
    folder: Path  # Folder of the study
    records: int  # Number of records
    computed: int  # Of those computed now
    kept: int  # Of those whose result was there
    failed: Mapping[str, str]  # Reasons by bag
    seconds: float  # Duration of this run
    verdicts: Mapping[str, int]  # Number of records by verdict; empty but for "diagnose"
    others: int  # Results that are kept of records that the manifest does not list

    def document(self) -> dict[str, Any]:
        """Summary as JSON types."""
        return {
            "schema": SCHEMA,
            "version": 1,
            "kind": self.kind,
            "results": str(self.folder / "records.parquet"),
            "records": self.records,
            "computed": self.computed,
            "kept": self.kept,
            "failed": [{"bag": bag, "reason": reason} for bag, reason in self.failed.items()],
            "seconds": self.seconds,
            "verdicts": dict(self.verdicts),
        }

    @property
    def refusal(self) -> str:
        """The first reason where every record failed; "" otherwise."""
        return next((f"{bag}: {reason}" for bag, reason in self.failed.items()), "") if self.exit_status else ""

    @property
    def exit_status(self) -> int:
        """Status 2 where every record failed: what was given is no fleet's records."""
        return 2 if self.records == len(self.failed) else 0

    def text(self) -> str:
        """Summary in lines."""
        lines = [
            f"{self.records} records: {self.computed} computed in {self.seconds:.1f} s, {self.kept} kept from before, "
            f"{len(self.failed)} failed"
        ]
        lines += [f"{count:8d}  {verdict}" for verdict, count in sorted(self.verdicts.items(), key=lambda item: -item[1])]
        lines += [f"failed: {bag}: {reason}" for bag, reason in list(self.failed.items())[:MAX_NAMED]]
        if len(self.failed) > MAX_NAMED:
            lines.append(f"and {len(self.failed) - MAX_NAMED} more, see records.parquet")
        if self.others:
            lines.append(f"kept in {self.folder / OTHERS}: {self.others} results of records that the manifest does not list")
        return "\n".join([*lines, f"written: {self.folder / 'records.parquet'}", f"written: {self.folder / 'fleet.html'}"])


def run_study(
    kind: str,
    entries: Sequence[Entry],
    folder: str | Path,
    options: Mapping[str, Any],
    workers: Workers,
    note: Callable[[str], None] = lambda line: None,
    limits: Mapping[str, float] | None = None,
    split: bool = False,
) -> Study:
    """Compute what is missing of a study."""
    if kind not in KINDS:
        raise InputError(f"{kind}: no such study, one of {', '.join(KINDS)} is due")
    for entry in entries:
        if kind != "identify" and not entry.model and not entry.baseline:
            raise InputError(f"{entry.bag}: has no model: name one in the manifest's column model, or with --model")
    folder = Path(folder)
    _check_kind(folder, kind)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: {error.strerror}: choose another folder") from None
    version = installed_version("")
    entries = _columns_apart(entries, schema(kind, ()).names)
    columns = list(dict.fromkeys(name for entry in entries for name in entry.columns))
    results = Results(folder, kind, columns)
    known = results.marks()
    unfinished = {"schema": SCHEMA, "version": 1, "kind": kind, "finished": False}
    write_json(folder / SUMMARY, {**unfinished, "records": len(entries)})
    if split:
        entries = split_axes(entries, folder, options.get("namespace"), options.get("unit", "unknown"))
        write_json(folder / SUMMARY, {**unfinished, "records": len(entries)})
    begin = time.monotonic()
    run = _Run(results, workers, version, known, note)
    run.compute([RecordJob(kind, entry, options, os.path.realpath(folder)) for entry in entries])
    if options.get("only") == ONSETS:
        # Without what a diagnosis named: the changes must not depend on where a run was ended.
        rows = [{**row, "verdict": OPEN, "effects": []} if row["status"] == DONE else row for row in _rows(results, entries)]
        changed = _changed(overview(kind, rows, columns, limits), rows)
        whole = {**options, "only": GAPS}
        run.compute([RecordJob(kind, entry, whole, os.path.realpath(folder)) for entry in entries if entry.bag in changed])
    rows = _rows(results, entries)
    others = results.join(rows)
    write_overview(overview(kind, rows, columns, limits), rows, folder)
    verdicts = Counter(row["verdict"] for row in rows if row["status"] == DONE) if kind == "diagnose" else Counter()
    kept = len(entries) - len(run.computed | set(run.failed))
    study = Study(kind, folder, len(entries), len(run.computed), kept, run.failed, time.monotonic() - begin, verdicts, others)
    write_json(folder / SUMMARY, {**study.document(), "finished": True})
    return study


class _Run:
    """A run of a study: records computed, and what became of them."""

    def __init__(
        self, results: Results, workers: Workers, version: str, known: Mapping[str, str], note: Callable[[str], None]
    ) -> None:
        self.results, self.workers, self.version, self.known, self.note = results, workers, version, known, note
        self.computed: set[str] = set()
        self.failed: dict[str, str] = {}

    def compute(self, wanted: Sequence[RecordJob]) -> None:
        """Compute what is not known yet."""
        begin = time.monotonic()
        jobs: list[RecordJob] = []
        marks: dict[str, str] = {}
        for job in wanted:
            bag = job.entry.bag
            try:
                marks[bag] = mark(job, self.version)
                # A run that was diagnosed for a change needs no look again.
                onsets = job.options.get("only") == ONSETS
                closer = mark(replace(job, options={**job.options, "only": GAPS}), self.version) if onsets else ""
            except OSError as error:
                self.failed[bag] = f"{error.filename}: {error.strerror}"
                self.results.add(_row(job, "", self.version, None, self.failed[bag]))
                continue
            if self.known.get(bag) not in (marks[bag], closer):
                jobs.append(job)
        try:
            for done, outcome in enumerate(outcomes(compute, jobs, self.workers) if jobs else (), 1):
                bag = outcome.job.entry.bag
                self.computed.add(bag)
                if outcome.result is None:
                    self.failed[bag] = outcome.reason
                self.results.add(_row(outcome.job, marks[bag], self.version, outcome.result, outcome.reason))
                spent = time.monotonic() - begin
                self.note(
                    f"{done}/{len(jobs)} records, {done / spent:.1f} a second, {spent / done * (len(jobs) - done):.0f} s to go"
                )
        finally:
            self.results.flush()  # also when interrupted: what is computed stays


def _rows(results: Results, entries: Sequence[Entry]) -> list[dict[str, Any]]:
    """Newest row of every record of the manifest, with the manifest's columns as they are now."""
    newest = results.newest()
    return [{**newest[entry.bag], **_listed(entry)} for entry in entries if entry.bag in newest]


def _changed(seen: Overview, rows: Sequence[Mapping[str, Any]]) -> set[str]:
    """Bags to diagnose: of every unit that changed the record with the largest gap since its most probable change."""
    since: dict[str, float] = {}
    for onset in seen.onsets:  # most probable first
        since.setdefault(onset.unit, onset.moment)
    for trend in seen.trends:
        since.setdefault(trend.unit, float("-inf"))
    clearest: dict[str, Mapping[str, Any]] = {}
    for row in rows:
        unit = row["unit"]
        if row["status"] != DONE or not row["moment"] >= since.get(unit, float("inf")) or row["gap_rms"] is None:
            continue
        # A gap to the model alone is none to baseline records: those with clean ones first.
        clearest[unit] = max(clearest.get(unit, row), row, key=lambda one: (bool(one["baseline"]), one["gap_rms"]))
    return {row["bag"] for row in clearest.values()}


def _columns_apart(entries: Sequence[Entry], own: Sequence[str]) -> list[Entry]:
    """Entries whose columns are none of the study's own: `status` of a manifest is `manifest.status`."""
    return [
        replace(each, columns={f"manifest.{name}" if name in own else name: value for name, value in each.columns.items()})
        for each in entries
    ]


def _row(job: RecordJob, found: str, version: str, result: Mapping[str, Any] | None, reason: str) -> dict[str, Any]:
    ends = {"status": FAILED if result is None else DONE, "reason": reason, "version": version, "mark": found}
    return {**_listed(job.entry), **(result or {}), **ends}


def _listed(entry: Entry) -> dict[str, Any]:
    """Columns of a row that come from the manifest."""
    own = {name: getattr(entry, name) for name in ("unit", "time", "moment", "bag", "model")}
    return {**own, "baseline": list(entry.baseline), **entry.columns}


def _check_kind(folder: Path, kind: str) -> None:
    path = folder / SUMMARY
    if not path.exists():
        if folder.is_dir() and any(folder.iterdir()):
            raise InputError(f"{folder}: is not empty and holds no study: choose another folder")
        return
    known = read_json(path).get("kind")
    if known != kind:
        raise InputError(f"{folder}: holds a study of another kind ({known}): choose another folder")
