"""Injected cases: known effects put into measured records, so that the physics is real and the truth exact.

Every size is a multiple of what the identified model leaves on clean records that it was not identified from. `injections` has the effects,
`injected_machines` the records, `injected_plan` which is put into which.
"""

from __future__ import annotations

import hashlib
import shutil
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evaluation.blind_test.error_report import error_report
from evaluation.blind_test.injected_machines import SIMULATED, Clean, Machine, mirror_machine, simulated_machine, stack_machine
from evaluation.blind_test.injected_plan import planned
from evaluation.blind_test.injected_scores import injected_metrics
from evaluation.blind_test.injections import apply_all, size_of, strength_of, structural_rms
from evaluation.blind_test.published_labels import rounded
from hyst_control.errors import InputError
from hyst_control.files import read_json, write_json
from hyst_control.parallel import Workers
from hyst_control.records.record import Record, Signal
from hyst_control.reporting.tables import Table

Array = NDArray[np.float64]

SCORING = 1000
"""First seed that is drawn from the records set apart for scoring."""
PLANTS = ("stack", "mirror", "simulated")


def make(out: str, seed: int, count: int, plants: Sequence[str] | None = None, note: Callable[[str], None] = print) -> Path:
    """Draw injected cases, record them, and write their labels to a separate file."""
    from hyst_control.model_file import simulate

    for name in plants or ():
        if name not in PLANTS:
            raise InputError(f"--plants: must be among {', '.join(PLANTS)} with --measured, got {name}")
    folder, labels = Path(out), Path(out) / "labels.json"
    given: dict[str, Any] = {"seed": seed, "count": count, "plants": list(plants or PLANTS)}
    if labels.exists():
        known = read_json(labels)
        if {name: known.get(name) for name in given} != given:
            raise InputError(f"{labels}: holds cases of another seed, count or plants: choose another folder")
        note(f"labels: SHA-256 {_digest(labels)}")
        return labels
    if folder.exists() and any(folder.iterdir()) and not (folder / "cases").is_dir():
        raise InputError(f"{folder}: holds files that are not of a blind test: choose another folder")
    machines = _machines(given["plants"], seed >= SCORING)
    models: dict[str, Any] = {}
    documents = []
    for index, cell in enumerate(planned(machines, seed, count)):
        machine = cell.machine
        if machine.name not in models:
            models[machine.name] = machine.model()
            note(f"{machine.name}: model {models[machine.name].name}")
        model = models[machine.name]
        clean, seeds = machine.cases[cell.record], (seed, index, 1)
        first = round(machine.warm_up / machine.sample_time)
        own = structural_rms(clean.measurement - simulate(model, clean.command), first)
        strengths = [strength_of(one, clean, machine.sample_time, cell.multiple * own, seeds, first) for one in cell.injections]
        command, measurement = apply_all(cell.injections, strengths, clean, machine.sample_time, seeds)
        name = f"case_{index:04d}"
        beside = {"none": (), "other_command": machine.others, "same_command": (machine.same.get(cell.record),)}[cell.mode]
        _write(folder / "cases" / name, machine, model, name, (command, measurement), [one for one in beside if one is not None])
        gap = structural_rms(measurement - simulate(model, command), first)
        documents.append(
            {
                "name": name,
                "plant": machine.name,
                "record": clean.name,
                "mode": cell.mode,
                "kind": cell.kind,
                "names": [one.name for one in cell.injections],
                "realizations": [one.realization for one in cell.injections],
                "multiple": cell.multiple,
                "strengths": strengths,
                "truth": [
                    {parameter: np.broadcast_to(value, len(machine.axes)).tolist() for parameter, value in known.items()}
                    for one, strength in zip(cell.injections, strengths, strict=True)
                    for known in [one.truth(strength, clean.command, clean.measurement, machine.sample_time)]
                ],
                "axes": list(machine.axes),
                "own_error_rms": own,
                "effect_rms": size_of(command, measurement, clean, first),
                "gap_rms": gap,
                "shrink": 1.0 - (own / gap) ** 2,
                "one_frequency": machine.name == "stack",
            }
        )
    write_json(labels, {**given, "cases": rounded(documents)})
    note(f"labels: SHA-256 {_digest(labels)}")
    return labels


def _machines(plants: Sequence[str], scoring: bool) -> list[Machine]:
    machines: list[Machine] = []
    if "stack" in plants:
        machines.append(stack_machine(scoring))
    if "mirror" in plants:
        machines += [mirror_machine(scoring, level) for level in range(3)]
    if "simulated" in plants:
        machines += [simulated_machine(name, scoring) for name in SIMULATED[: 2 if scoring else 1]]
    return machines


def _write(place: Path, machine: Machine, model: Any, name: str, rows: tuple[Array, Array], beside: Sequence[Clean]) -> None:
    """Write all that the diagnosis of a case sees."""
    from hyst_control.model_file import save_model
    from hyst_control.records.importing import write_bag

    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    write_bag(place / "bag", _record(machine, *rows, name))
    for number, other in enumerate(beside):
        write_bag(place / f"clean_{number}", _record(machine, other.command, other.measurement, f"clean {number}"))
    save_model(model, place / "model.yaml")
    write_json(place / "case.json", {"warm_up": machine.warm_up})


def run(
    out: str,
    seed: int,
    count: int,
    plants: Sequence[str] | None = None,
    page: str | None = None,
    note: Callable[[str], None] = print,
    workers: Workers | None = None,
) -> Table:
    """Draw, diagnose and score injected cases; what an interrupted run has done is kept."""
    from evaluation.blind_test.page import write_injected_page
    from evaluation.blind_test.scores import table

    labels = make(out, seed, count, plants, note)
    diagnose_all(Path(out), note, workers)
    rows = load(Path(out))
    command = f"blind-test --injected --seed {seed} --count {count}" + (f" --plants {' '.join(plants)}" if plants else "")
    found = injected_metrics(rows)
    if page is not None:
        write_injected_page(Path(page), found, rows, command, _digest(labels))
    return table(found, command)


def diagnose_all(folder: Path, note: Callable[[str], None] = print, workers: Workers | None = None) -> None:
    """Diagnose every case that has no report yet, each from its bags and a model alone."""
    from evaluation.blind_test.diagnosis_queue import work

    work(jobs_of(folder if workers is None else folder.resolve()), None, note, workers)


def jobs_of(folder: Path) -> list[tuple[Callable[[Any], str], tuple[Any, ...]]]:
    """List the diagnoses that have no report yet."""
    reports = folder / "reports"
    reports.mkdir(exist_ok=True)
    waiting = [case.name for case in sorted((folder / "cases").iterdir()) if not (reports / f"{case.name}.json").exists()]
    return [(_diagnose_one, (str(folder), name)) for name in waiting]


def load(folder: Path) -> list[tuple[dict[str, Any], dict[str, Any]]]:
    """Read the cases that were diagnosed."""
    documents = read_json(folder / "labels.json")["cases"]
    found = [(one, folder / "reports" / f"{one['name']}.json") for one in documents]
    return [(one, read_json(path)) for one, path in found if path.exists()]


def _record(machine: Machine, command: Array, measurement: Array, name: str) -> Record:
    axis = machine.sample_time * np.arange(len(command), dtype=np.float64)
    signals = {"command": Signal(axis, command, machine.axes, "V"), "measurement": Signal(axis, measurement, machine.axes, "um")}
    return Record(signals, name)


def _diagnose_one(job: tuple[str, str]) -> str:
    from hyst_control.diagnose.workflow import diagnosed
    from hyst_control.model_file import load_model
    from hyst_control.records.bag_reader import read_bag

    out, name = job
    place = Path(out) / "cases" / name
    begin, worked = time.monotonic(), time.process_time()
    warm_up = float(read_json(place / "case.json")["warm_up"])
    clean = [read_bag(path) for path in sorted(place.glob("clean_*"))]
    try:
        document, *_ = diagnosed([read_bag(place / "bag")], load_model(place / "model.yaml"), warm_up=warm_up, baseline=clean)
    except Exception as error:  # a fault of the diagnosis costs this case
        document = error_report(error)
    document["seconds"], document["processor_seconds"] = time.monotonic() - begin, time.process_time() - worked
    write_json(Path(out) / "reports" / f"{name}.json", document)
    return name


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
