# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""`hyst demo`: excite, record, identify, track and diagnose, and the HAMPI paper's Table 5 beside the result."""

from __future__ import annotations

import json
import shutil
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.config_files import config_path
from hyst_control.base.errors import InputError
from hyst_control.control.feedforward.compensator import build_compensator
from hyst_control.control.feedforward.reachable_stroke import check_reachable
from hyst_control.control.tuning import tune
from hyst_control.demo import figures as demo_figures
from hyst_control.demo.composed_run import run_composed
from hyst_control.demo.node_runs import run_processes
from hyst_control.diagnose.workflow import diagnose_bags
from hyst_control.identify.workflow import Result, identify_bags
from hyst_control.model_file import Model
from hyst_control.records.bags.bag_reader import read_bag
from hyst_control.records.excitation import excitation
from hyst_control.records.excitation.waveforms import smooth_step
from hyst_control.reporting.provenance import provenance
from hyst_control.reporting.tables import Table

SAMPLE_TIME = 5e-5
PLANT = "pea"
SEED = 20261
PEAK = 60.0  # V, of the excitation: what a 4 um reference on a 1 um offset needs, and a little more
BLOCK = 500
OFFSET, STROKE = 1.0, 4.0
FREQUENCIES = (10.0, 50.0, 100.0, 150.0)
CYCLES = {10.0: 3, 50.0: 5, 100.0: 6, 150.0: 8}
SCORED_CYCLES = 2
CONTROLLERS = {
    "static gain": ("hampi", "none", False),
    "HAPI": ("hapi", "hapi", False),
    "HAMPI": ("hampi", "hampi", False),
    "PI feedback": ("hampi", "proportional", True),
    "HAMPI + PI": ("hampi", "hampi", True),
}
"""Model, kind of its feedforward (proportional of gain 0: none at all), and whether there is feedback, by controller."""
PUBLISHED = {"HAPI": (3.92, 3.86, 6.71, 8.75), "HAMPI": (1.50, 1.28, 1.61, 2.25)}  # NRMSE in %, HAMPI paper Table 5
SLEW_LIMIT = 2e6
WITHHELD = {"name": "slew_limit", "rate": 3e4}  # Effect in the actuator that the diagnosis has to find
RATING = (0.0, 150.0)

Runner = Callable[..., Path]  # Function that runs the loop into a bag: `run_processes`, or without ROS `run_composed`


class Stretch(NamedTuple):
    """Rows of the tracking record that count for one frequency."""

    frequency: float
    begin: int
    end: int


def run(folder: str | Path = "demo_out", progress: Callable[[str], None] = lambda step: None, ros: bool = True) -> Table:
    """Run the demo into a folder, which appears only when everything is done; an earlier demo's folder is replaced."""
    runner: Runner = run_processes if ros else run_composed
    folder = Path(folder)
    if folder.exists() and not (folder / "summary.json").is_file():
        raise InputError(f"{folder}: exists and is not an earlier demo's: choose another folder or remove it")
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder.parent, prefix=f".{folder.name}-") as temporary:
        work = Path(temporary) / "demo"
        work.mkdir()
        table = _run(work, progress, runner)
        if folder.exists():
            shutil.rmtree(folder)
        work.rename(folder)
    return table


def _run(work: Path, progress: Callable[[str], None], runner: Runner) -> Table:
    bags, models = work / "bags", work / "models"
    bags.mkdir()
    models.mkdir()
    progress("excite and record")
    signal = excitation.build({"signal": "hampi_identification", "peak": PEAK, "lower": RATING[0], "upper": RATING[1]}, SAMPLE_TIME)
    plant = str(config_path(f"plants/{PLANT}.yaml"))
    recorded = excited(runner, work / "excitation", signal, {"plant": plant, "seed": SEED})
    shutil.move(recorded, bags / "excitation")
    results: dict[str, Result] = {}
    for family in ("hapi", "hampi"):
        progress(f"identify {family.upper()}")
        results[family] = identify_bags(
            [bags / "excitation"], family, models / f"{family}.yaml", json_path=work / f"fit_{family}.json"
        )
    reference, stretches = tracking_reference()
    hampi = results["hampi"].fit.model
    check_reachable(hampi, reference, RATING)
    tracked: dict[str, Path] = {}
    for controller in CONTROLLERS:
        progress(f"track with {controller}")
        tracked[controller] = bags / controller.lower().replace(" + ", "_").replace(" ", "_")
        shutil.move(track(runner, work / "tracking", controller, reference, results, models, plant), tracked[controller])
        shutil.rmtree(work / "tracking")
    shutil.rmtree(work / "excitation")
    progress("diagnose a withheld effect")
    gap = diagnose_withheld(runner, work, models / "hampi.yaml", plant)
    progress("figures and report")
    measured = {controller: aligned(bag) for controller, bag in tracked.items()}
    table = score(measured, reference, stretches)
    drawn = demo_figures.Tracked(SAMPLE_TIME, reference, measured, stretches)
    origins = provenance(
        [("records", sorted(bags.iterdir())), ("models", sorted(models.glob("*.yaml")))],
        [("plant", f"{PLANT}, seed {SEED}; while tracking seed {SEED + 1}")],
    )
    fits = {name: result.fit for name, result in results.items()}
    demo_figures.write(work, bags / "excitation", fits, drawn, table, gap, origins)
    table.write(work / "summary.json")
    return table


def excited(runner: Runner, folder: Path, signal: Array, plant: Mapping[str, Any]) -> Path:
    """Record a plant under an excitation: a drive in V, which passes the feedforward with gain 1."""
    settings = {
        "hampi_feedforward": {"kind": "proportional", "gain": [1.0], "offset": [0.0]},
        "pi_feedback": {"lower": RATING[0], "upper": RATING[1], "start": "first_command"},
        "plant": plant,
    }
    return runner(folder, signal, SAMPLE_TIME, settings, block=BLOCK)


def diagnose_withheld(runner: Runner, work: Path, model: Path, plant: str) -> dict[str, Any]:
    """Record the actuator with an effect that the model does not have, and diagnose the record without telling which."""
    signal = excitation.build({"signal": "diagnostic", "lowest": 0.0, "highest": 50.0, "duration": 0.7}, SAMPLE_TIME)
    given = {"plant": plant, "seed": SEED + 2, "effects": json.dumps([WITHHELD])}
    recorded = excited(runner, work / "withheld", signal, given)
    bag = work / "bags" / "withheld"
    shutil.move(recorded, bag)
    shutil.rmtree(work / "withheld")
    diagnose_bags([bag], model, json=str(work / "gap.json"), report=str(work / "gap.html"))
    return {**json.loads((work / "gap.json").read_text(encoding="utf-8")), "withheld": WITHHELD}


def tracking_reference() -> tuple[Array, list[Stretch]]:
    """Build the reference: from 0 to the offset, then loops of 4 um at each frequency with rests between, all of limited jerk."""
    ramp = OFFSET * smooth_step(np.arange(round(0.05 / SAMPLE_TIME)) * SAMPLE_TIME / 0.05)
    pieces = [ramp, excitation.rest(SAMPLE_TIME, 0.02, OFFSET)]
    stretches = []
    for frequency in FREQUENCIES:
        begin = sum(len(piece) for piece in pieces)
        cycles = CYCLES[frequency] + 2  # the loops fade in over the first and out over the last
        wave = excitation.loops(SAMPLE_TIME, frequency, STROKE, cycles)
        through = np.arange(len(wave)) * SAMPLE_TIME * frequency
        wave = np.asarray(OFFSET + wave * smooth_step(through) * smooth_step(cycles - through))
        scored, end = (round(count / frequency / SAMPLE_TIME) for count in (SCORED_CYCLES, cycles - 1))
        stretches.append(Stretch(frequency, begin + end - scored, begin + end))
        pieces += [wave, excitation.rest(SAMPLE_TIME, 0.01, OFFSET)]
    return np.concatenate(pieces)[:, None], stretches


def track(
    runner: Runner,
    folder: Path,
    controller: str,
    reference: Annotated[Array, "N 1"],
    results: dict[str, Result],
    models: Path,
    plant: str,
) -> Path:
    """Run one tracking experiment."""
    family, kind, closed = CONTROLLERS[controller]
    model: Model = results[family].fit.model
    if kind == "proportional":
        preview, feedforward = 0, {"kind": kind, "gain": [0.0], "offset": [0.0]}
    else:
        preview = build_compensator(model, kind, sample_time=SAMPLE_TIME, limits=RATING).preview
        feedforward = {"kind": kind, "model": str(models / f"{family}.yaml"), "limits": list(RATING)}
    feedback = {"lower": RATING[0], "upper": RATING[1], "slew_limit": SLEW_LIMIT, "feedback": closed}
    if closed:
        tuned = tune(model, sample_time=SAMPLE_TIME)
        feedback |= {"kp": tuned.kp, "ki": tuned.ki}
    nodes = {"hampi_feedforward": feedforward, "pi_feedback": feedback, "plant": {"plant": plant, "seed": SEED + 1}}
    return runner(folder, reference, SAMPLE_TIME, nodes, block=1 if closed else BLOCK, lead=preview + 1)


def aligned(bag: Path) -> dict[str, Array]:
    """Read every signal of a tracking bag on one clock."""
    signals = ("reference", "feedforward", "feedback", "command", "measurement")
    return read_bag(bag).aligned(signals)[0].values


def score(measured: dict[str, dict[str, Array]], reference: Annotated[Array, "N 1"], stretches: list[Stretch]) -> Table:
    """Compute the tracking error of the last cycles at every frequency: NRMSE in % of the range (HAMPI paper Eq. 26)."""
    table = Table("demo")
    for index, stretch in enumerate(stretches):
        rows = slice(stretch.begin, stretch.end)
        for controller, signals in measured.items():
            error = signals["measurement"][rows] - reference[rows]
            rmse = float(np.sqrt(np.mean(error**2)))
            span = float(np.ptp(reference[rows]))
            published = PUBLISHED[controller][index] if controller in PUBLISHED else None
            place = "simulated stage, beside HAMPI Table 5", f"{stretch.frequency:g} Hz", controller
            table.add(*place, "nrmse", "%", 100 * rmse / span, published=published, n=1)
            table.add(*place, "rmse", "um", rmse, n=1)
    return table
