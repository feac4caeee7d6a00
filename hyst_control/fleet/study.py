"""Studies: every record of a manifest identified, validated or diagnosed, on as many workers as there are, and taken up again.

What a record's result depends on is in its mark (`record_jobs.mark`): a record whose mark is in the results already is not computed
again. A record that fails is listed with its reason, and tried again the next time.
"""

from __future__ import annotations

import os
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as installed
from pathlib import Path
from typing import Any

from hyst_control.errors import InputError
from hyst_control.files import read_json, write_json
from hyst_control.fleet.manifest import Entry
from hyst_control.fleet.overview import overview
from hyst_control.fleet.overview_page import write_overview
from hyst_control.fleet.record_jobs import KINDS, RecordJob, compute, mark
from hyst_control.fleet.results import DONE, FAILED, Results
from hyst_control.fleet.split_axes import split_axes
from hyst_control.parallel import Outcome, Workers, outcomes

SCHEMA = "hyst_control/fleet"
SUMMARY = "summary.json"
MOST_NAMED = 10


@dataclass(frozen=True)
class Study:
    """Result of a run of a study.

    Parameters
    ----------
    kind
        "identify", "validate" or "diagnose".
    folder
        Folder of the study.
    records, computed, kept
        Number of records, of those computed now, and of those whose result was there.
    failed
        Reasons by bag.
    seconds
        Duration of this run.
    verdicts
        Number of records by verdict; empty but for "diagnose".
    """

    kind: str
    folder: Path
    records: int
    computed: int
    kept: int
    failed: Mapping[str, str]
    seconds: float
    verdicts: Mapping[str, int]

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
        lines += [f"failed: {bag}: {reason}" for bag, reason in list(self.failed.items())[:MOST_NAMED]]
        if len(self.failed) > MOST_NAMED:
            lines.append(f"and {len(self.failed) - MOST_NAMED} more, see records.parquet")
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
    """Compute what is missing of a study.

    Parameters
    ----------
    kind
        "identify", "validate" or "diagnose".
    entries
        The records.
    folder
        Folder of the study; created, or taken up again.
    options
        Options of the computation.
    workers
        Where it is computed.
    note
        Called with a line of progress now and then.
    limits
        Limits by quantity, for the forecast of drifts.
    split
        Whether every axis of a record is a unit of its own.

    Returns
    -------
    Study
        What was done.

    Raises
    ------
    InputError
        The study is of another kind, a record has no model, or results cannot be written.
    """
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
    version = _version()
    columns = list(dict.fromkeys(name for entry in entries for name in entry.columns))
    results = Results(folder, kind, columns)
    known = results.marks()
    unfinished = {"schema": SCHEMA, "version": 1, "kind": kind, "finished": False}
    write_json(folder / SUMMARY, {**unfinished, "records": len(entries)})
    if split:
        entries = split_axes(entries, folder, options.get("namespace"), options.get("unit", "unknown"))
        write_json(folder / SUMMARY, {**unfinished, "records": len(entries)})
    begin = time.monotonic()
    failed: dict[str, str] = {}
    jobs: list[RecordJob] = []
    marks: dict[str, str] = {}
    for entry in entries:
        job = RecordJob(kind, entry, options, os.path.realpath(folder))
        try:
            marks[entry.bag] = mark(job, version)
        except OSError as error:
            failed[entry.bag] = f"{error.filename}: {error.strerror}"
            results.add(_row(job, "", version, None, failed[entry.bag]))
            continue
        if known.get(entry.bag) != marks[entry.bag]:
            jobs.append(job)
    kept = len(entries) - len(jobs) - len(failed)
    try:
        for done, outcome in enumerate(_computed(jobs, workers), 1):
            bag = outcome.job.entry.bag
            if outcome.result is None:
                failed[bag] = outcome.reason
            results.add(_row(outcome.job, marks[bag], version, outcome.result, outcome.reason))
            spent = time.monotonic() - begin
            note(f"{done}/{len(jobs)} records, {done / spent:.1f} a second, {spent / done * (len(jobs) - done):.0f} s to go")
    finally:
        results.flush()  # also when interrupted: what is computed stays
    results.join([entry.bag for entry in entries])
    rows = list(results.rows())
    write_overview(overview(kind, rows, columns, limits), rows, folder)
    verdicts = Counter(row["verdict"] for row in rows if row["status"] == DONE) if kind == "diagnose" else Counter()
    study = Study(kind, folder, len(entries), len(jobs), kept, failed, time.monotonic() - begin, verdicts)
    write_json(folder / SUMMARY, {**study.document(), "finished": True})
    return study


def _computed(jobs: Sequence[RecordJob], workers: Workers) -> Iterator[Outcome[RecordJob, dict[str, Any]]]:
    if jobs:
        yield from outcomes(compute, jobs, workers)


def _row(job: RecordJob, found: str, version: str, result: Mapping[str, Any] | None, reason: str) -> dict[str, Any]:
    entry = job.entry
    return {
        "unit": entry.unit,
        "time": entry.time,
        "moment": entry.moment,
        "bag": entry.bag,
        "model": entry.model,
        "baseline": list(entry.baseline),
        **entry.columns,
        **(result or {}),
        "status": FAILED if result is None else DONE,
        "reason": reason,
        "version": version,
        "mark": found,
    }


def _check_kind(folder: Path, kind: str) -> None:
    path = folder / SUMMARY
    if not path.exists():
        if folder.is_dir() and any(folder.iterdir()):
            raise InputError(f"{folder}: is not empty and holds no study: choose another folder")
        return
    known = read_json(path).get("kind")
    if known != kind:
        raise InputError(f"{folder}: holds a study of another kind ({known}): choose another folder")


def _version() -> str:
    try:
        return installed("hyst_control")
    except PackageNotFoundError:  # run from its folder
        return ""
