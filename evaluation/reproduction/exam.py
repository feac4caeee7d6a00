# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Exam of the diagnosis on machines whose nonlinearity other people have described (docs/exam.md).

A linear model of each machine is identified from its lowest level, and its highest level is diagnosed with it. Machines with one level
have a linear model of their record, of which `own_records` asks what it lacks. The rule by which an answer is right is `is_right`; it was
written before the first diagnosis.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from evaluation.reproduction import bouc_wen
from evaluation.reproduction.figures import write_page
from evaluation.reproduction.fsm_cubespec_records import FIT, TEST, load_levels, model_of
from evaluation.reproduction.measured_data import data_folder, read
from hyst_control.api.record import from_arrays
from hyst_control.base import progress
from hyst_control.base.arrays import Array
from hyst_control.chain.chain import Chain
from hyst_control.diagnose.workflow import diagnose_records
from hyst_control.identify import identify
from hyst_control.identify.modal.modal_candidate import refined, stages_of
from hyst_control.identify.modal.modal_fit import subspace
from hyst_control.identify.modal.modal_model import Spectra
from hyst_control.identify.workflow import discrepancy, gapless_records, identify_records
from hyst_control.model_file import Model
from hyst_control.records.record import Record
from hyst_control.reporting.tables import Table


@dataclass(frozen=True)
class Truth:
    """Description of a machine by its authors, in the words of the gap report."""

    mechanisms: tuple[str, ...]
    structure: Mapping[str, bool] = field(default_factory=dict)
    """Answers that the description settles."""
    one_side: bool = False
    """True where a saturation is right at one side only."""


@dataclass(frozen=True)
class Case:
    """A record to diagnose with a model of the machine where it is linear, or with its own model."""

    model: Model
    record: Record
    own_records: bool
    warm_up: float = 0.0


@dataclass(frozen=True)
class Machine:
    """A machine of the exam."""

    name: str
    truth: Truth
    case: Callable[[], Case]


def tanks() -> Case:
    """Cascaded tanks, 4 s a sample: the record of the estimation, whose first 400 s level out what was before."""
    rows = read(data_folder("exam") / "tanks.csv", _columns)
    record = from_arrays(rows[:, 0], rows[:, 1], 0.25, command_unit="V", unit="V")
    return Case(_linear(record), record, own_records=True, warm_up=400.0)


def emps() -> Case:
    """The positioning drive: drive and speed as means of 10 ms. The drive was off before, and the carriage at rest."""
    arrays = _arrays("emps")
    drive, position = arrays["drive"].astype(float), 1e3 * arrays["position"]
    count = (len(position) - 1) // 10
    command = drive[: 10 * count].reshape(count, 10).mean(axis=1)
    speed = np.diff(position[: 10 * count + 1 : 10]) / 0.01
    record = from_arrays(np.append(0.0, command), np.append(0.0, speed), 100.0, command_unit="V", unit="mm/s", hold="foh")
    return Case(_linear(record, start="settled"), record, own_records=True)


def wiener_hammerstein() -> Case:
    """The circuit, 0.3 s of its excitation."""
    arrays = _arrays("wiener_hammerstein")
    rows = slice(5_200, 5_200 + 2**14)
    record = from_arrays(arrays["u"][rows].astype(float), arrays["y"][rows].astype(float), 51_200.0, command_unit="V", unit="V")
    return Case(_linear(record), record, own_records=True)


def f16_payload() -> Case:
    """The payload's acceleration at the highest level, with a model of ten states from the lowest one."""
    period, rate = 8192, 400.0
    low, high = (
        np.stack([arrays["force"], arrays["acceleration"]]).astype(float).reshape(2, -1, period)
        for arrays in (_arrays("f16_payload_level1"), _arrays("f16_payload_level7"))
    )
    steady = low[:, 1:].mean(axis=1)
    found = _modal(steady[0][:, None], steady[1][:, None], 1.0 / rate, 10, (1.0, 60.0))
    model = Model("f16", ("x",), {"command": "N", "measurement": "m/s^2"}, 1.0 / rate, found, "foh")
    records = [
        from_arrays(level[0, 1:4].ravel(), level[1, 1:4].ravel(), rate, command_unit="N", unit="m/s^2", hold="foh")
        for level in (low, high)
    ]
    return Case(_with_discrepancy(model, records[0]), records[1], own_records=False, warm_up=period / rate)


def mirror() -> Case:
    """The mirror at 300 mV, with a model of eight modes from 100 mV."""
    low, _, high = load_levels()
    fit = refined([low.spectra(FIT)], subspace([low.spectra(FIT)], [16], np.zeros(3), "zoh")[0], True, False, 25)
    model = replace(model_of(fit.model, "mirror", 1.0), valid={})
    model = _with_discrepancy(model, low.record(FIT[0]))
    return Case(model, high.record(TEST[0]), own_records=False, warm_up=1.28)


def oscillator() -> Case:
    """The Bouc-Wen oscillator: the mean period twice, at 1500 Hz."""
    periods, _ = bouc_wen.load()
    data = bouc_wen.training_record(periods, 2)
    command, measurement = (np.tile(signal[:, 0], 2) for signal in (data.command, data.measurement))
    record = from_arrays(command, measurement, 1.0 / data.sample_time, command_unit="V", unit="um", hold="foh")
    model = identify([data], "linear", "joint").model  # the period is preceded by itself
    return Case(model, record, own_records=True, warm_up=len(data.command) * data.sample_time)


MACHINES = (
    Machine("cascaded tanks", Truth(("output_saturation", "root_outflow"), {"even": True}), tanks),
    Machine("EMPS positioning drive", Truth(("dry_friction",), {"memory": True, "even": False}), emps),
    Machine(
        "Wiener-Hammerstein circuit",
        Truth(("saturation", "output_saturation"), {"memory": False, "even": True}, one_side=True),
        wiener_hammerstein,
    ),
    Machine("F-16 payload", Truth(("softening_modes", "dry_friction", "dead_zone"), {"memory": True}), f16_payload),
    Machine("CubeSpec mirror", Truth(("softening_modes",), {"even": False}), mirror),
    Machine("Bouc-Wen oscillator", Truth(("hysteresis_width", "dry_friction"), {"memory": True, "even": False}), oscillator),
)


TITLE = "Named nonlinearity"


def is_right(truth: Truth, report: Mapping[str, Any]) -> bool:
    """True where the report names a mechanism first, or is `unknown` with the structure that the description settles."""
    if report["verdict"] in ("effect", "ambiguous"):
        first = report["effects"][0]
        limits = [row["value"] for name, row in first["parameters"].items() if name in ("lower", "upper")]
        one_side = not truth.one_side or sum(value is not None and np.isfinite(value) for value in limits) == 1
        return first["name"] in truth.mechanisms and one_side
    found = structure_of(report)
    return report["verdict"] == "unknown" and all((found.get(name, 0.5) > 0.5) == due for name, due in truth.structure.items())


def structure_of(report: Mapping[str, Any]) -> dict[str, float]:
    """Probability of "yes" by question of an unknown gap."""
    return {row["question"]: row["probability"] for row in report.get("structure", ())}


def run(figures: str | None = None, machines: Sequence[Machine] = MACHINES) -> Table:
    """Diagnose every machine and return the table."""
    table = Table("reproduce exam")
    if machines is MACHINES:
        data_folder("exam"), data_folder("fsm_cubespec"), data_folder("bouc_wen")
    right = 0
    for machine in machines:
        progress.step(machine.name)
        began = time.perf_counter()
        case = machine.case()
        identified = time.perf_counter()
        report = diagnose_records([case.record], case.model, own_records=case.own_records, warm_up=case.warm_up).document
        seconds = time.perf_counter() - identified
        is_good = is_right(machine.truth, report)
        right += is_good
        names = [each["name"] for each in report["effects"]]
        answer = f"{report['verdict']}: {', '.join(names)}" if names else report["verdict"]
        add = partial(table.add, TITLE, machine.name, answer)
        add("right", "", float(is_good))
        add("gap", "% of range", report["gap"]["nrmse"])
        for key in ("shrink", "shrink_reidentified"):
            values = [each[key] for each in report["effects"] if each[key] is not None]
            if values:
                add(key, "%", 100.0 * values[0])
        for question, probability in structure_of(report).items():
            add(f"structure_{question}", "", probability)
        add("identification_time", "s", identified - began)
        add("diagnosis_time", "s", seconds)
    table.add(TITLE, "all", "exam", "right", "", right, n=len(machines))
    if figures is not None:
        write_page(figures, table)
    return table


def _arrays(name: str) -> Mapping[str, Array]:
    return read(data_folder("exam") / f"{name}.npz", lambda path: dict(np.load(path)))


def _columns(path: Path) -> Array:
    """Rows (N, C) of a table of two or more columns below a line of names. Raises `ValueError` where there are none."""
    rows = np.array([line.split(",") for line in path.read_text(encoding="utf-8").splitlines()[1:]], dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] < 2:
        raise ValueError("holds no rows of two numbers")
    return rows


def _linear(record: Record, start: str = "auto") -> Model:
    """Linear model of a record."""
    return identify_records([record], "linear", start=start, force=True).model


def _modal(command: Array, measurement: Array, sample_time: float, states: int, band: tuple[float, float]) -> Chain:
    """Modal model of a steady period (N, A) within a band, for a command that is smooth between its samples."""
    period = len(command)
    u, y = (np.sqrt(2.0 / period) * np.fft.rfft(signal, axis=0)[..., None] for signal in (command, measurement))
    frequency = np.arange(len(u)) / (period * sample_time)
    lines = np.flatnonzero((frequency >= band[0]) & (frequency <= band[1]))
    data = [Spectra(2 * np.pi * lines / period, u[lines], y[lines], True)]
    fit = refined(data, subspace(data, [states], np.zeros(command.shape[1]), "foh")[0], True, False, 25)
    return Chain(tuple(stages_of(fit.model, sample_time)))


def _with_discrepancy(model: Model, record: Record) -> Model:
    """The model with what it leaves of its own level, which begins amid a motion."""
    return replace(model, discrepancy=discrepancy(model, gapless_records(record, model.hold, "unknown")))
