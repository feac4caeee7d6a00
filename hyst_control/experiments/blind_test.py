"""The blind test: cases drawn from truth plants, diagnosed by processes that never see their labels, then scored.

Folder of a run: cases/NAME/{bag, model.yaml} is all that a diagnosis gets, labels.json stands apart (its SHA-256 is printed before
anything is diagnosed), reports/NAME.json (and .yaml, the augmented model) is what the diagnosis wrote. A run that was interrupted goes on where it stopped.
"""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from hyst_control.errors import InputError
from hyst_control.files import write_json

LEFT_OUT: dict[str, tuple[str, ...]] = {
    "delay": ("delay",), "creep": ("creep",), "sensor_lowpass": ("sensor_lowpass",), "amplifier_lowpass": ("amplifier_lowpass",),
}
"""Effects whose near-equivalents are in the catalogue under another name; see gap-diagnosis: confusable by nature."""


def make(folder: Path, seed: int, count: int, left_out: bool = False, note: Callable[[str], None] = print, **options: Any) -> Path:
    """Draw the cases of a seed, record them, and write their labels apart; returns the labels' file.

    left_out: diagnose every single effect with that effect taken out of the catalogue. Nothing that exists is made again.
    """
    from hyst_control.model_file import save_model
    from hyst_plant_sim import cases as drawn

    labels = folder / "labels.json"
    if labels.exists():
        known = json.loads(labels.read_text(encoding="utf-8"))
        if (known["seed"], known["count"]) != (seed, count):
            raise InputError(f"{labels}: is of seed {known['seed']} and {known['count']} cases: choose another folder")
        note(f"labels: SHA-256 {_digest(labels)}")
        return labels
    (folder / "cases").mkdir(parents=True, exist_ok=True)
    cases = drawn.draw(seed, count, **options)
    documents = []
    for case, document in zip(cases, _mapped(_make_one, [(case, str(folder / "cases")) for case in cases]), strict=True):
        documents.append(document)
        if len(documents) % 50 == 0:
            note(f"{len(documents)} of {count} cases recorded ({case.name})")
    for plant, noise in sorted({(case.plant, case.noise) for case in cases}):
        path = folder / "models" / f"{plant}_{noise:g}.yaml"
        path.parent.mkdir(exist_ok=True)
        save_model(drawn.nominal(plant, noise), path)
    for case in cases:
        shutil.copy(folder / "models" / f"{case.plant}_{case.noise:g}.yaml", folder / "cases" / case.name / "model.yaml")
    write_json(labels, {"seed": seed, "count": count, "left_out": left_out, "cases": documents})
    note(f"labels: SHA-256 {_digest(labels)}")
    return labels


def diagnose_all(folder: Path, without: dict[str, Sequence[str]] | None = None, reports: str = "reports",
                 note: Callable[[str], None] = print) -> None:
    """Diagnose every case that has no report yet, one process per core; they get a bag and a model, nothing else."""
    (folder / reports).mkdir(exist_ok=True)
    waiting = [case for case in sorted((folder / "cases").iterdir()) if not (folder / reports / f"{case.name}.json").exists()
               and (without is None or case.name in without)]
    begin = time.monotonic()
    jobs = [(str(case), str(folder / reports / f"{case.name}.json"), tuple((without or {}).get(case.name, ()))) for case in waiting]
    for done, name in enumerate(_mapped(_diagnose_one, jobs), 1):
        if done % 20 == 0 or done == len(jobs):
            spent = time.monotonic() - begin
            note(f"{done} of {len(jobs)} diagnosed ({name}), {spent:.0f} s, {spent / done * (len(jobs) - done):.0f} s to go")


def load(folder: Path, reports: str = "reports") -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """(case document with its label, report) of every case that was diagnosed."""
    for case in json.loads((folder / "labels.json").read_text(encoding="utf-8"))["cases"]:
        file = folder / reports / f"{case['name']}.json"
        if file.exists():
            yield case, json.loads(file.read_text(encoding="utf-8"))


def _make_one(job: tuple[Any, str]) -> dict[str, Any]:
    from hyst_control.importing import write_bag
    from hyst_plant_sim import cases as drawn

    case, folder = job
    bag = Path(folder) / case.name / "bag"
    shutil.rmtree(bag.parent, ignore_errors=True)
    bag.parent.mkdir(parents=True)
    write_bag(bag, drawn.record_of(case, drawn.run(case)))
    return drawn.as_document(drawn.labelled(case))


def _diagnose_one(job: tuple[str, str, tuple[str, ...]]) -> str:
    from hyst_control.bag_reader import read_bag
    from hyst_control.diagnose.workflow import diagnosed
    from hyst_control.model_file import load_model, save_model

    case, report, without = job
    begin = time.monotonic()
    document, _, better = diagnosed([read_bag(Path(case) / "bag")], load_model(Path(case) / "model.yaml"), without=without)
    document["seconds"] = time.monotonic() - begin
    if better is not None:
        save_model(better, Path(report).with_suffix(".yaml"))
    write_json(report, document)
    return Path(case).name


def _mapped(work: Callable[[Any], Any], jobs: Sequence[Any]) -> Iterator[Any]:
    """In order, over all cores, in processes of their own."""
    workers = min(os.cpu_count() or 1, len(jobs))
    if workers < 2:
        yield from map(work, jobs)
        return
    with multiprocessing.get_context("spawn").Pool(workers, maxtasksperchild=100) as pool:
        yield from pool.imap(work, jobs)


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
