"""The blind test: cases drawn from reference simulations, diagnosed by processes that never see their labels, then scored.

Folder of a run: cases/NAME/{bag, model.yaml, next.npy} is all the input of a diagnosis (next.npy is the command of a fresh record, for
which it predicts the shrink), labels.json is kept separate (its SHA-256 is printed before anything is diagnosed), reports/NAME.json (and
.yaml, the augmented model) is the output of the diagnosis. A run that was interrupted goes on where it stopped.
"""

from __future__ import annotations

import hashlib
import json
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from evaluation.blind_test.diagnosis_queue import Job, interleaved, work
from evaluation.blind_test.error_report import error_report
from evaluation.blind_test.published_labels import rounded
from hyst_control.errors import InputError
from hyst_control.files import read_json, write_json
from hyst_control.parallel import Workers, map_spawned
from hyst_control.reporting.tables import Table

if TYPE_CHECKING:
    from evaluation.blind_test.case import Case

CONFUSABLE = {
    "amplifier_lowpass": ("sensor_lowpass", "delay"),
    "sensor_lowpass": ("amplifier_lowpass", "delay"),
    "delay": ("amplifier_lowpass", "sensor_lowpass"),
    "gain": ("hysteresis_width",),
    "hysteresis_width": ("gain",),
    "creep": ("offset_drift", "gain_drift"),
    "offset_drift": ("creep", "gain_drift"),
    "gain_drift": ("creep", "offset_drift"),
}
"""Effects of nearly the same signature, which are left out together."""


def run_all(
    out: str,
    seed: int,
    count: int,
    left_out: int = 0,
    page: str | None = None,
    json_path: str | None = None,
    note: Callable[[str], None] = print,
    so_far: bool = False,
    injected_count: int = 0,
    stop_after: float | None = None,
    without_gap: int = 0,
    workers: Workers | None = None,
) -> Table:
    """Run the whole test: draw, diagnose, leave out, compare the predictions with fresh records, score, write."""
    # injected_count: number of cases that are injected into records of machines, in the folder `injected` of the run; the
    # measurements are needed
    from evaluation.blind_test import injected
    from evaluation.blind_test.injected_scores import injected_metrics
    from evaluation.blind_test.scores import metrics, novelty_quantile, table

    folder = _folder(out, count)
    if workers is not None:
        folder = folder.resolve()  # the workers of a cluster have folders of their own to begin in
    put_in, quiet = folder / "injected", folder / "without_gap"
    digests = {"": _digest(make(folder, seed, count, note))}
    if injected_count:
        digests["injected"] = _digest(injected.make(str(put_in), seed, injected_count, note=note))
    if without_gap:
        quiet.mkdir(exist_ok=True)
        digests["without a gap"] = _digest(make(quiet, seed, without_gap, note, kinds=("none",)))
    if not so_far:
        jobs = [jobs_of(folder, left_out)]
        jobs += [injected.jobs_of(put_in)] if injected_count else []
        jobs += [jobs_of(quiet)] if without_gap else []
        work(interleaved(*jobs), None if stop_after is None else time.time() + stop_after, note, workers)
    add_realized_shrinks(folder, note)
    pairs = list(load(folder))
    if not pairs:
        raise InputError(f"{folder}: no case has been diagnosed yet: call without --so-far")
    others = list(load(folder, "reports_left_out")) if left_out else []
    rows = injected.load(put_in) if injected_count else []
    further = [({**case, "name": f"without_gap/{case['name']}"}, report) for case, report in load(quiet)] if without_gap else []
    singles = [report for label, report in rows if label["kind"] == "single"]
    singles += [report for case, report in pairs if case["label"]["kind"] == "single"]
    found = [*metrics(pairs, others, further), *injected_metrics(rows), *novelty_quantile(singles)]
    command = f"blind-test --seed {seed} --count {count} --left-out {left_out}"
    command += f" --with-injected {injected_count}" if injected_count else ""
    command += f" --without-gap {without_gap}" if without_gap else ""
    result = table(found, command)
    if json_path is not None:
        result.write(json_path)
    if page is not None:
        from evaluation.blind_test.page import write_page

        write_page(Path(page), found, pairs, rows, further, command, (count, injected_count, without_gap), digests, len(others))
    return result


def make_cases(
    out: str,
    seed: int,
    count: int,
    plants: Sequence[str] | None = None,
    kinds: Sequence[str] | None = None,
    excitations: Sequence[str] | None = None,
    switched: float = 0.0,
    note: Callable[[str], None] = print,
) -> Path:
    """Draw and record cases with their labels, without a diagnosis; see `make` and `case_drawing.draw`."""
    from evaluation.blind_test.case import EXCITATIONS, KINDS
    from evaluation.blind_test.plant_setups import SETUPS

    for option, asked, known in (
        ("plants", plants, SETUPS),
        ("kinds", kinds, KINDS),
        ("excitations", excitations, EXCITATIONS),
    ):
        for name in asked or ():
            if name not in known:
                raise InputError(f"--{option}: must be among {', '.join(known)}, got {name}")
    if not 0 <= switched <= 1:
        raise InputError(f"--switched: must be from 0 to 1, got {switched:g}")
    given = {"plants": plants, "kinds": kinds, "excitations": excitations, "switched": switched}
    return make(_folder(out, count), seed, count, note, **{name: value for name, value in given.items() if value})


def _folder(out: str, count: int) -> Path:
    if count < 1:
        raise InputError(f"--count: must be >= 1, got {count}")
    folder = Path(out)
    if folder.exists() and not (folder / "labels.json").exists() and any(folder.iterdir()) and not (folder / "cases").is_dir():
        raise InputError(f"{folder}: holds files that are not of a blind test: choose another folder")
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def make(folder: Path, seed: int, count: int, note: Callable[[str], None] = print, **options: Any) -> Path:
    """Draw the cases of a seed, record them, and write their labels to a separate file.

    Labels that are there already are kept: a run goes on where it stopped.
    """
    from evaluation.blind_test.case_drawing import draw
    from evaluation.blind_test.nominal_models import nominal, stated_noise
    from hyst_control.model_file import save_model

    labels = folder / "labels.json"
    if labels.exists():
        known = read_json(labels)
        if (known.get("seed"), known.get("count")) != (seed, count):
            raise InputError(
                f"{labels}: holds seed {known.get('seed')} and {known.get('count')} cases, not seed {seed} and {count}: "
                "choose another folder"
            )
        if options and json.loads(json.dumps(options)) != known.get("options"):
            raise InputError(f"{labels}: was drawn with other options: choose another folder")
        note(f"labels: SHA-256 {_digest(labels)}")
        return labels
    (folder / "cases").mkdir(parents=True, exist_ok=True)
    cases = draw(seed, count, **options)
    stated = {key: stated_noise(*key) for key in sorted({(case.plant, case.noise) for case in cases})}
    documents = []
    jobs = [(case, str(folder / "cases"), stated[case.plant, case.noise]) for case in cases]
    for case, document in zip(cases, map_spawned(_make_one, jobs), strict=True):
        documents.append(document)
        if len(documents) % 50 == 0:
            note(f"{len(documents)} of {count} cases recorded ({case.name})")
    for plant, noise in stated:
        path = folder / "models" / f"{plant}_{noise:g}.yaml"
        path.parent.mkdir(exist_ok=True)
        save_model(nominal(plant, noise), path)
    for case in cases:
        shutil.copy(folder / "models" / f"{case.plant}_{case.noise:g}.yaml", folder / "cases" / case.name / "model.yaml")
    write_json(labels, {"seed": seed, "count": count, **({"options": options} if options else {}), "cases": rounded(documents)})
    note(f"labels: SHA-256 {_digest(labels)}")
    return labels


def diagnose_all(folder: Path, note: Callable[[str], None] = print) -> None:
    """Diagnose every case that has no report yet, one process per core, each from a bag and a model alone."""
    work(jobs_of(folder), None, note)


def jobs_of(folder: Path, left_out: int = 0) -> list[Job]:
    """List the diagnoses that have no report yet, in the order of the cases."""
    # left_out: largest number of cases, single effects on the rich record, that are diagnosed again, without the effect and those
    # nearly equal to it in the catalogue
    from hyst_control.effects import EFFECTS

    jobs: list[Job] = []
    for name in ("reports", "reports_left_out"):
        (folder / name).mkdir(exist_ok=True)
    for case in read_json(folder / "labels.json")["cases"]:
        place, label = str(folder / "cases" / case["name"]), case["label"]
        jobs.append((_diagnose_one, (place, str(folder / "reports" / f"{case['name']}.json"), ())))
        name = (label["names"] or [""])[0]
        if left_out and label["kind"] == "single" and label["excitation"] == "rich" and EFFECTS[name].waveform:
            left_out -= 1
            without = (name, *CONFUSABLE.get(name, ()))
            jobs.append((_diagnose_one, (place, str(folder / "reports_left_out" / f"{case['name']}.json"), without)))
    return [job for job in jobs if not Path(job[1][1]).exists()]


def add_realized_shrinks(folder: Path, note: Callable[[str], None] = print) -> None:
    """Add to every shrink that a report predicts the one measured on a fresh record: another session, another excitation.

    A line of the augmented model is left out there, because its phase is that of the diagnosed record.
    """
    jobs = [
        (case, str(folder / "reports" / f"{case['name']}.json"), str(folder / "cases" / case["name"] / "model.yaml"))
        for case, report in load(folder)
        if "shrink_realised" not in report
        and report["verdict"] == "effect"
        and any(effect["shrink"] is not None for effect in report["effects"])
    ]
    for _ in map_spawned(_add_realized_shrink, jobs):
        pass
    note(f"{len(jobs)} predicted shrinks held against fresh records")


def load(folder: Path, reports: str = "reports") -> Iterator[tuple[dict[str, Any], dict[str, Any]]]:
    """Read the cases that were diagnosed."""
    for case in read_json(folder / "labels.json")["cases"]:
        file = folder / reports / f"{case['name']}.json"
        if file.exists():
            yield case, read_json(file)


def _fresh(case: Case) -> Case:
    """The same plant under another excitation, on which predictions are checked."""
    return replace(case, excitation="multisine" if case.excitation == "rich" else "rich")


def _make_one(job: tuple[Case, str, float]) -> dict[str, Any]:
    import numpy as np

    from evaluation.blind_test.case import as_document
    from evaluation.blind_test.case_labels import with_label
    from evaluation.blind_test.case_records import commands, record_of, run_case
    from hyst_control.records.importing import write_bag

    case, folder, stated = job
    bag = Path(folder) / case.name / "bag"
    shutil.rmtree(bag.parent, ignore_errors=True)
    bag.parent.mkdir(parents=True)
    write_bag(bag, record_of(case, run_case(case)))
    np.save(bag.parent / "next.npy", commands(_fresh(case)))
    return as_document(with_label(case, stated))


def _diagnose_one(job: tuple[str, str, tuple[str, ...]]) -> str:
    import numpy as np

    from hyst_control.diagnose.report.predicted_reduction import foresee
    from hyst_control.diagnose.workflow import diagnosed
    from hyst_control.model_file import load_model, save_model
    from hyst_control.records.bag_reader import read_bag

    case, report, without = job
    begin, worked = time.monotonic(), time.process_time()
    diagnosis = better = None
    try:
        document, diagnosis, better = diagnosed(
            [read_bag(Path(case) / "bag")], load_model(Path(case) / "model.yaml"), without=without
        )
    except Exception as error:  # a fault of the diagnosis costs this case
        document = error_report(error)
    document["seconds"], document["processor_seconds"] = time.monotonic() - begin, time.process_time() - worked
    if diagnosis is not None:
        document["foreseen"] = foresee(diagnosis, np.load(Path(case) / "next.npy")).document()
    if better is not None:
        save_model(better, Path(report).with_suffix(".yaml"))
    write_json(report, document)
    return Path(case).name


def _add_realized_shrink(job: tuple[dict[str, Any], str, str]) -> None:
    import numpy as np

    from evaluation.blind_test.case import Case
    from evaluation.blind_test.case_records import run_case
    from evaluation.blind_test.plant_setups import SETUPS
    from hyst_control.diagnose.report.augmented_model import without_lines
    from hyst_control.model_file import load_model, simulate

    document, path, nominal = job
    report = read_json(path)
    case = _fresh(
        Case(
            document["name"],
            document["plant"],
            document["kind"],
            document["excitation"],
            document["noise"],
            document["seed"],
            tuple(document["effects"]),
            document["off"],
            duration=document["duration"],
        )
    )
    signals = run_case(case, later=True)
    command, measured = signals["command"], signals["measurement"]
    model, better = load_model(nominal), without_lines(load_model(Path(path).with_suffix(".yaml")))
    before, after = (float(np.mean((measured - simulate(m, command)) ** 2)) for m in (model, better))
    floor = (case.noise * SETUPS[case.plant].stroke) ** 2
    realized = 1.0 - (after - floor) / max(before - floor, 1e-300)
    predicted = max(effect["shrink"] for effect in report["effects"] if effect["shrink"] is not None)
    report["shrink_realised"] = [predicted, float(np.clip(realized, -10.0, 1.0)), case.excitation]
    write_json(path, report)


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
