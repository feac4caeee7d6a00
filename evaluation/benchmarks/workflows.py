# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Time and memory of an identification and of a diagnosis, each in a separate process."""

from __future__ import annotations

import resource
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import ParamSpec, TypeVar

import numpy as np

from evaluation.blind_test.case_drawing import draw
from evaluation.blind_test.case_records import record_of, respond, run_case
from evaluation.blind_test.nominal_models import nominal
from evaluation.blind_test.plant_setups import SETUPS
from hyst_control.base.arrays import Array
from hyst_control.base.parallel import executor
from hyst_control.diagnose.workflow import diagnosed
from hyst_control.identify import identify
from hyst_control.model_file import simulate
from hyst_control.records.excitation import excitation
from hyst_control.records.record import Record, sampled_record
from hyst_control.reporting.tables import Limit, Table
from hyst_plant_sim.physics import load_plant

P = ParamSpec("P")
T = TypeVar("T")

RATE = 20e3  # Hz
SECONDS = 60.0
IDENTIFIED: dict[str, tuple[str, tuple[str, ...], str, float, Callable[[float], Array]]] = {
    "hampi": ("pea", ("x",), "um", 1e-4, excitation.hampi_identification),
    "mhl": ("fsm", ("x", "y"), "mrad", 1e-6, partial(excitation.mhl_identification, axes=2)),
}
"""By family: truth plant, axes, unit, noise, and the excitation of the family's paper."""
PLANTS = ("pea_published", "fsm_published", "third")
DRIVEN = 1.8
"""Length of the excitation that is diagnosed, s: with its rests a record of 2 s."""
SHORT = 0.4
"""The same of the record that kernels are compiled with, s."""


def run(table: Table, seconds: float = SECONDS, plants: Sequence[str] = PLANTS) -> None:
    """Measure identifications, and diagnoses with a new and with a cached threshold."""
    for family in IDENTIFIED:
        elapsed, processor, memory, rows, once = _alone(identification, family, seconds)
        case = f"{seconds:g} s at {RATE / 1e3:g} kHz"
        limit = Limit(once, "one simulation of the record")
        table.add("identification", case, family, "identify_time", "s", elapsed, n=rows, limit=limit)
        table.add("identification", case, family, "identify_processor_time", "s", processor, n=rows)
        table.add("identification", case, family, "identify_memory", "MiB", memory, n=rows)
    for plant in plants:
        fresh, cached, rows, seconds_of_record = _alone(diagnosis, plant)
        case = f"{seconds_of_record:.2g} s at {rows / seconds_of_record / 1e3:.3g} kHz"
        table.add("diagnosis", f"{case}, threshold calibrated", plant, "diagnose_time", "s", fresh, n=rows)
        table.add("diagnosis", f"{case}, threshold cached", plant, "diagnose_time", "s", cached, n=rows)


def identification(family: str, seconds: float) -> tuple[float, float, float, int, float]:
    """Time and memory of one identification, and time of one simulation; a tenth of the record is identified first, which compiles."""
    plant, axes, unit, noise, signal = IDENTIFIED[family]
    rows = signal(1.0 / RATE).reshape(-1, len(axes))
    once, count = len(rows), round(seconds * RATE)
    rows = np.tile(rows, (-(-count // once), 1))[:count]
    truth = load_plant({"plant": plant}, seed=1, sample_time=1.0 / RATE, noise=noise)
    record = sampled_record("bench", rows, respond(truth, rows), 1.0 / RATE, axes, unit, start="settled")
    identify([record.rows(0, min(once, count))], family)
    begin, before = time.perf_counter(), processor_time()
    model = identify([record], family).model
    elapsed, processor = time.perf_counter() - begin, processor_time() - before
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    begin = time.perf_counter()
    simulate(model, rows)
    return elapsed, processor, memory, count, time.perf_counter() - begin


def diagnosis(plant: str) -> tuple[float, float, int, float]:
    """Time of one diagnosis: one effect, diagnostic excitation, sampled at `RATE`. Changes the plant's setup in this process."""
    SETUPS[plant] = replace(SETUPS[plant], sample_time=1.0 / RATE)
    case = replace(draw(0, 1, [plant], {"single": 1.0}, ["rich"])[0], duration=DRIVEN)
    record: Record = record_of(case, run_case(case))
    model = nominal(plant, case.noise)
    short = replace(case, duration=SHORT)
    diagnosed([record_of(short, run_case(short))], model, seed=1)  # compiles the kernels
    begin = time.perf_counter()
    diagnosed([record], model, seed=1, cache=False)
    fresh = time.perf_counter() - begin
    diagnosed([record], model, seed=1)
    begin = time.perf_counter()
    diagnosed([record], model, seed=1)
    signal = record.signal("measurement")
    return fresh, time.perf_counter() - begin, len(signal.time), float(signal.time[-1] - signal.time[0])


def processor_time() -> float:
    """Processor time (s) in user mode of this process and of its workers that have ended."""
    return sum(resource.getrusage(whose).ru_utime for whose in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


def _alone(task: Callable[P, T], *arguments: P.args, **named: P.kwargs) -> T:
    """Return a task's result from a separate process, so that its memory is measured alone."""
    with executor(1, serial=False) as pool:
        return pool.submit(task, *arguments, **named).result()
