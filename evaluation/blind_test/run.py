# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The blind test: cases are made, diagnosed by processes that never see their labels, then scored.

Folder of a run: cases/NAME/{bag, clean_*, model.yaml, next.npy, case.json} is the input of a diagnosis (baseline records; the command of
a later session; the begin that does not count). labels.json, whose SHA-256 is printed first, is kept apart. Its output is
reports/NAME.json, with the augmented model in .yaml, and separation/NAME.json for the ideal observer. results.csv has a row for every
case.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from evaluation.blind_test import injected, simulated, withheld
from evaluation.blind_test.case import Case, Made, as_document, from_document
from evaluation.blind_test.case_drawing import draw
from evaluation.blind_test.effect_sizes import FILE
from evaluation.blind_test.ideal_observer import separation
from evaluation.blind_test.injected_machines import PLANTS, SCORING, machines_of
from evaluation.blind_test.scores import ERROR, Result, metrics, score, table, write_results
from hyst_control.base.errors import InputError
from hyst_control.base.files import read_json, write_json
from hyst_control.base.parallel import Workers, map_spawned, outcomes
from hyst_control.diagnose.report.predicted_reduction import foresee
from hyst_control.diagnose.run.diagnosis import BY_REGIME
from hyst_control.diagnose.workflow import diagnosed
from hyst_control.effects import EFFECTS
from hyst_control.model_file import Model, load_model, save_model
from hyst_control.records.bags.bag_reader import read_bag
from hyst_control.records.record import Record
from hyst_control.records.tables.importing import write_bag
from hyst_control.reporting.tables import Table

CONFUSABLE: dict[str, tuple[str, ...]] = FILE["confusable"]
"""Effects of nearly the same signature, which are left out together."""

MADE: dict[str, Callable[[Case], Made]] = {"simulated": simulated.made, "injected": injected.made, "withheld": withheld.made}

Job = tuple[str, str, tuple[str, ...], str]
"""Folder of a case, its report, the effects that are left out of the catalogue, and the core of the diagnosis."""


@dataclass(frozen=True)
class Batch:
    """Cases of one source that are drawn together, in a folder of the run."""

    source: str  # "simulated", "injected" or "withheld"
    folder: Path
    seed: int = 0
    count: int = 0  # All of the withheld cases, whose number nobody asks for
    options: Mapping[str, Any] = field(default_factory=dict)  # Of the drawing
    role: str = ""  # "without_gap" of further cases, which only the rows of false alarms count
    left_out: int = 0  # Cases with one effect that are diagnosed again without it in the catalogue
    core: str = BY_REGIME  # Core of the diagnosis

    @property
    def labels(self) -> Path:
        """File of the labels."""
        return self.folder / "labels.json"

    def drawn(self) -> list[Case]:
        """Draw the cases, which have no label yet."""
        if self.source == "simulated":
            return draw(self.seed, self.count, **self.options)
        if self.source == "injected":
            machines = machines_of(self.options.get("plants") or PLANTS, self.seed >= SCORING)
            return list(injected.planned(machines, self.seed, self.count))
        return withheld.drawn(**self.options)

    def cases(self) -> list[Case]:
        """Read the cases that were made."""
        return [from_document(one) for one in read_json(self.labels)["cases"]]

    def results(self) -> list[Result]:
        """Score the cases that were diagnosed."""
        found = []
        for folder, role in (("reports", self.role), ("reports_left_out", "left_out")):
            for case in self.cases():
                path, apart = (self.folder / place / f"{case.name}.json" for place in (folder, "separation"))
                if path.exists():
                    parts = json.loads(apart.read_text()) if apart.exists() and not role else None
                    found.append(score(case, read_json(path), role, parts))
        return found


def run(
    batches: Sequence[Batch],
    command: str,
    page: str | None = None,
    note: Callable[[str], None] = print,
    so_far: bool = False,
    stop_after: float | None = None,
    workers: Workers | None = None,
) -> Table:
    """Make the cases, diagnose them, hold the predictions against later sessions, score, and write."""
    for batch in batches:
        make(batch, note)
    if not so_far:
        diagnose_all(batches, None if stop_after is None else time.time() + stop_after, note, workers)
    for batch in batches:
        add_realized(batch)
    results = [result for batch in batches for result in batch.results()]
    if not results:
        raise InputError(f"{batches[0].folder}: no case has been diagnosed yet: call without --so-far")
    write_results(batches[0].folder / "results.csv", results)
    found = metrics(results)
    if page is not None:
        from evaluation.blind_test.page import write_page

        asked = sum(len(batch.cases()) for batch in batches)
        digests = {batch.role or batch.source: _digest(batch.labels) for batch in batches}
        write_page(Path(page), found, results, command, asked, digests)
    return table(found, command)


def make(batch: Batch, note: Callable[[str], None] = print) -> Path:
    """Draw the cases of a batch, write their files, and their labels to a separate file; labels that are there already are kept."""
    folder, labels, options = batch.folder, batch.labels, dict(batch.options)
    if batch.count < 1 and batch.source != "withheld":
        raise InputError(f"--count: must be >= 1, got {batch.count}")
    if labels.exists():
        known = read_json(labels)
        asked = {"seed": batch.seed, "options": json.loads(json.dumps(options)) or known.get("options")}
        asked["count"] = batch.count or known.get("count")
        if any(known.get(name) != value for name, value in asked.items()):
            raise InputError(f"{labels}: holds cases of another seed, count or choice: choose another folder")
        note(f"labels: SHA-256 {_digest(labels)}")
        return labels
    if folder.exists() and not (folder / "cases").is_dir() and any(folder.iterdir()):
        raise InputError(f"{folder}: holds files that are not of a blind test: choose another folder")
    cases = batch.drawn()
    (folder / "cases").mkdir(parents=True, exist_ok=True)
    jobs = [(case, folder / "cases") for case in cases]
    documents = []
    # A machine's model is identified once for its cases, on all cores.
    for case in map_spawned(_make_one, jobs) if batch.source == "simulated" else map(_make_one, jobs):
        documents.append(as_document(case))
        if len(documents) % 50 == 0:
            note(f"{len(documents)} of {len(cases)} cases made ({case.name})")
    head = {"seed": batch.seed, "count": len(cases), **({"options": options} if options else {})}
    write_json(labels, {**head, "cases": documents})
    note(f"labels: SHA-256 {_digest(labels)}")
    return labels


def diagnose_all(
    batches: Sequence[Batch], until: float | None = None, note: Callable[[str], None] = print, workers: Workers | None = None
) -> None:
    """Diagnose every case that has no report yet, each from its files alone, until a given time.

    The batches take turns, so that a run that is stopped has done the same part of each. A cluster's workers must see the folders under
    the same path.
    """
    begin = time.monotonic()
    lists = [_jobs(batch, workers is not None) for batch in batches]
    placed = [((index + 0.5) / len(jobs), job) for jobs in lists for index, job in enumerate(jobs)]
    due = [(job, until) for _, job in sorted(placed, key=lambda each: each[0])]
    for done, name in enumerate(map_spawned(_in_time, due) if workers is None else _names(due, workers, note), 1):
        if name and (done % 20 == 0 or done == len(due)):
            spent = time.monotonic() - begin
            note(f"{done} of {len(due)} diagnosed ({name}), {spent:.0f} s, {spent / done * (len(due) - done):.0f} s to go")


def add_realized(batch: Batch) -> None:
    """Add to every report on a simulated case that predicts a reduction the one measured in a later session."""
    jobs = []
    for case in batch.cases() if batch.source == "simulated" else ():
        path = batch.folder / "reports" / f"{case.name}.json"
        report = read_json(path) if path.exists() else {"verdict": ""}
        predicts = report["verdict"] == "effect" and "shrink_realised" not in report and _predicted(report) is not None
        if predicts and path.with_suffix(".yaml").exists():  # effects that widen the gap are in no augmented model
            jobs.append((case, path, batch.folder / "cases" / case.name / "model.yaml"))
    for _ in map_spawned(_realize_one, jobs):
        pass


def _jobs(batch: Batch, absolute: bool) -> list[Job]:
    """Diagnoses that have no report yet; of some cases, single effects on the rich record, a second one without the effect."""
    folder, left_out = batch.folder.resolve() if absolute else batch.folder, batch.left_out
    jobs: list[Job] = []
    for name in ("reports", "reports_left_out", "separation"):
        (folder / name).mkdir(exist_ok=True)
    for case in batch.cases():
        place, file = str(folder / "cases" / case.name), f"{case.name}.json"
        jobs.append((place, str(folder / "reports" / file), (), batch.core))
        name = (case.answer.names or ("",))[0]
        if left_out and case.answer.kind == "single" and case.excitation == "rich" and EFFECTS[name].waveform:
            left_out -= 1
            hidden = (name, *(other for group in CONFUSABLE.values() if name in group for other in group if other != name))
            jobs.append((place, str(folder / "reports_left_out" / file), hidden, batch.core))
    return [job for job in jobs if not Path(job[1]).exists()]


def _make_one(job: tuple[Case, Path]) -> Case:
    """Write the files of a case, and return it with its label."""
    case, folder = job
    made, place = MADE[case.source](case), folder / case.name
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    write_bag(place / "bag", made.record)
    for number, clean in enumerate(made.beside):
        write_bag(place / f"clean_{number}", clean)
    save_model(made.model, place / "model.yaml")
    if made.warm_up:
        write_json(place / "case.json", {"warm_up": made.warm_up})
    if made.coming is not None:
        np.save(place / "next.npy", made.coming)
    return made.of(case)


def read_case(place: Path) -> tuple[Record, Model, float, list[Record]]:
    """Record, model, begin that does not count, and baseline records of a case, from its files."""
    warm_up = read_json(place / "case.json")["warm_up"] if (place / "case.json").exists() else 0.0
    clean = [read_bag(path) for path in sorted(place.glob("clean_*"))]
    return read_bag(place / "bag"), load_model(place / "model.yaml"), warm_up, clean


def _diagnose_one(job: Job) -> str:
    """Diagnose a case from its files; return its name."""
    place, report = Path(job[0]), Path(job[1])
    begin, worked = time.monotonic(), time.process_time()
    diagnosis = better = None
    try:
        record, model, warm_up, clean = read_case(place)
        document, diagnosis, better = diagnosed([record], model, without=job[2], warm_up=warm_up, baseline=clean, core=job[3])
    except Exception as error:  # a fault of the diagnosis costs this case: no name, which every score counts as wrong
        text = f"{type(error).__name__}: {error}"
        document = {"verdict": ERROR, "error": text, "effects": [], "candidates": [], "unexplained_share": None}
    document["seconds"], document["processor_seconds"] = time.monotonic() - begin, time.process_time() - worked
    if diagnosis is not None and (place / "next.npy").exists():
        document["foreseen"] = foresee(diagnosis, np.load(place / "next.npy")).document()
    if better is not None:
        save_model(better, report.with_suffix(".yaml"))
    if diagnosis is not None and not job[2]:
        write_json(report.parents[1] / "separation" / report.name, [separation(part) for part in diagnosis.parts])
    write_json(report, document)
    return place.name


def _realize_one(job: tuple[Case, Path, Path]) -> None:
    case, path, model = job
    report = read_json(path)
    realized = simulated.realized_reduction(case, load_model(model), load_model(path.with_suffix(".yaml")))
    write_json(path, {**report, "shrink_realised": [_predicted(report), realized]})


def _predicted(report: Mapping[str, Any]) -> float | None:
    return max((effect["shrink"] for effect in report["effects"] if effect["shrink"] is not None), default=None)


def _in_time(due: tuple[Job, float | None]) -> str:
    """The name of the case that was diagnosed, "" after the time."""
    job, until = due
    return "" if until is not None and time.time() > until else _diagnose_one(job)


def _names(due: Sequence[tuple[Job, float | None]], workers: Workers, note: Callable[[str], None]) -> Iterator[str]:
    """Names of the cases as they are diagnosed; one that fails costs itself, and the next call does it again."""
    for outcome in outcomes(_in_time, due, workers):
        if outcome.result is None:
            note(f"a case was not diagnosed: {outcome.reason}")
        yield outcome.result or ""


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
