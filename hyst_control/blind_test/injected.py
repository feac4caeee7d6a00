"""Injected cases: known effects put into measured records, so that the physics is real and the truth exact.

Every size is a multiple of what the identified model leaves on clean records that it was not identified from. `injections` has the effects,
`injected_machines` the records.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hyst_control.blind_test.injected_machines import Machine, mirror_machine, stack_machine
from hyst_control.blind_test.injected_scores import MODES, SIZES, score, write_page
from hyst_control.blind_test.injections import OPEN_SET, SINGLES, Injection, strength_of
from hyst_control.blind_test.published_labels import rounded
from hyst_control.errors import InputError
from hyst_control.files import write_json
from hyst_control.parallel import mapped
from hyst_control.records.record import Record, Signal
from hyst_control.records.session_zero import without_zero
from hyst_control.reporting.tables import Table

Array = NDArray[np.float64]

SCORING = 1000
"""First seed that is drawn from the records set apart for scoring."""
PLANTS = ("stack", "mirror")


def make(out: str, seed: int, count: int, plants: Sequence[str] | None = None, note: Callable[[str], None] = print) -> Path:
    """Draw injected cases, record them, and write their labels to a separate file.

    Parameters
    ----------
    out
        Folder of the run.
    seed
        Seed of the cases; from `SCORING` on the records set apart for scoring are used.
    count
        Number of cases.
    plants
        Restriction to some of `PLANTS`; None: all.
    note
        Called with every line of progress.

    Returns
    -------
    Path
        File of the labels.

    Raises
    ------
    InputError
        A plant does not exist, the measurements are absent, or the folder is that of another run.
    """
    from hyst_control.model_file import save_model, simulate
    from hyst_control.records.importing import write_bag

    for name in plants or ():
        if name not in PLANTS:
            raise InputError(f"--plants: must be among {', '.join(PLANTS)} with --measured, got {name}")
    folder, labels = Path(out), Path(out) / "labels.json"
    given: dict[str, Any] = {"seed": seed, "count": count, "plants": list(plants or PLANTS)}
    if labels.exists():
        known = json.loads(labels.read_text(encoding="utf-8"))
        if {name: known.get(name) for name in given} != given:
            raise InputError(f"{labels}: holds cases of another seed, count or plants: choose another folder")
        note(f"labels: SHA-256 {_digest(labels)}")
        return labels
    if folder.exists() and any(folder.iterdir()) and not (folder / "cases").is_dir():
        raise InputError(f"{folder}: holds files that are not of a blind test: choose another folder")
    scoring = seed >= SCORING
    machines: list[Machine] = []
    if "stack" in given["plants"]:
        machines.append(stack_machine(scoring))
    if "mirror" in given["plants"]:
        machines += [mirror_machine(scoring, level) for level in range(3)]
    models = []
    for machine in machines:
        models.append(machine.model())
        note(f"{machine.name}: model {models[-1].name}")
    documents = []
    for index in range(count):
        random = np.random.default_rng([seed, index])
        which = index % len(machines)
        machine, model = machines[which], models[which]
        kind = str(random.choice(["single", "pair", "none", "open_set"], p=[0.65, 0.1, 0.15, 0.1]))
        mode = MODES[index // len(machines) % len(MODES)]
        at = int(random.integers(len(machine.cases)))
        if mode == "same_command":
            at = int(random.choice(sorted(machine.same)))
        clean = machine.cases[at]
        rest = without_zero(clean.measurement - simulate(model, clean.command))[0][
            len(clean.command) // 2 if machine.warm_up else 0 :
        ]
        own = float(np.sqrt(np.mean(rest**2)))
        multiple = float(random.choice(SIZES))
        chosen = _drawn(kind, random)
        strength, command, measurement = 0.0, clean.command, clean.measurement
        if chosen:
            strength, command, measurement = strength_of(chosen, clean, machine.sample_time, multiple * own, (seed, index, 1))
        name = f"case_{index:04d}"
        place = folder / "cases" / name
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir(parents=True)
        write_bag(place / "bag", _record(machine, command, measurement, name))
        beside = {"none": (), "other_command": machine.others, "same_command": (machine.same.get(at),)}[mode]
        for number, other in enumerate(one for one in beside if one is not None):
            write_bag(place / f"clean_{number}", _record(machine, other.command, other.measurement, f"clean {number}"))
        save_model(model, place / "model.yaml")
        write_json(place / "case.json", {"warm_up": machine.warm_up})
        documents.append(
            {
                "name": name,
                "plant": machine.name,
                "record": clean.name,
                "mode": mode,
                "kind": kind,
                "names": [one.name for one in chosen],
                "realizations": [one.realization for one in chosen],
                "multiple": multiple if chosen else 0.0,
                "strength": strength,
                "own_error_rms": own,
                "gap_rms": float(np.sqrt(np.mean((measurement - clean.measurement) ** 2))),
                "one_frequency": machine.name == "stack",
            }
        )
    write_json(labels, {**given, "cases": rounded(documents)})
    note(f"labels: SHA-256 {_digest(labels)}")
    return labels


def run(
    out: str,
    seed: int,
    count: int,
    plants: Sequence[str] | None = None,
    page: str | None = None,
    note: Callable[[str], None] = print,
) -> Table:
    """Draw, diagnose and score injected cases; what an interrupted run has done is kept.

    Parameters
    ----------
    out
        Folder of the run.
    seed
        Seed of the cases.
    count
        Number of cases.
    plants
        Restriction to some of `PLANTS`; None: all.
    page
        Page to write.
    note
        Called with every line of progress.

    Returns
    -------
    Table
        The figures.

    Raises
    ------
    InputError
        As `make`.
    """
    labels = make(out, seed, count, plants, note)
    reports = Path(out) / "reports"
    reports.mkdir(exist_ok=True)
    documents = json.loads(labels.read_text(encoding="utf-8"))["cases"]
    waiting = [one["name"] for one in documents if not (reports / f"{one['name']}.json").exists()]
    for done, name in enumerate(mapped(_diagnose_one, [(str(out), name) for name in waiting]), 1):
        note(f"{done} of {len(waiting)} diagnosed ({name})")
    rows = [(one, json.loads((reports / f"{one['name']}.json").read_text(encoding="utf-8"))) for one in documents]
    table = score(rows)
    if page is not None:
        write_page(Path(page), rows, table, seed, count, _digest(labels))
    return table


def _drawn(kind: str, random: np.random.Generator) -> list[Injection]:
    if kind == "none":
        return []
    if kind == "open_set":
        return [OPEN_SET[int(random.integers(len(OPEN_SET)))]]
    names = sorted({one.name for one in SINGLES})
    chosen = random.choice(names, 2 if kind == "pair" else 1, replace=False)
    found = []
    for name in chosen:
        realizations = [one for one in SINGLES if one.name == name]
        found.append(realizations[int(random.integers(len(realizations)))])
    return found


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
    begin = time.monotonic()
    warm_up = float(json.loads((place / "case.json").read_text(encoding="utf-8"))["warm_up"])
    clean = [read_bag(path) for path in sorted(place.glob("clean_*"))]
    document, *_ = diagnosed([read_bag(place / "bag")], load_model(place / "model.yaml"), warm_up=warm_up, baseline=clean)
    document["seconds"] = time.monotonic() - begin
    write_json(Path(out) / "reports" / f"{name}.json", document)
    return name


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
