# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Speed, size and bit equality of the exported C on this machine."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from evaluation.benchmarks import limits
from hyst_control.base import progress
from hyst_control.base.arrays import Array
from hyst_control.base.config_files import config_path
from hyst_control.control.feedback.pi import PI
from hyst_control.control.feedforward.compensator import Compensator, build_compensator
from hyst_control.export.c_source import Program
from hyst_control.export.compiled import CompiledProgram
from hyst_control.export.controller import Controller, FaultResponse
from hyst_control.export.programs import Exported, FeedforwardOptions, feedforward, simulator
from hyst_control.model_file import load_model
from hyst_control.reporting.tables import Limit, Table

ROWS = 20_000
REPEATS = 30
COMPARED = 10_000_000
"""Samples over which C and Python are compared."""
BLOCK = 500_000

CONTROLLERS = (
    ("hampi feedforward + PI, 10 operators, 1 axis", "pea_hampi", "hampi", 20e3),
    ("mhl feedforward + PI, 2 axes", "fsm_mhl", "mhl", 5e3),
)
"""Case, model, kind of the feedforward, and rate in Hz."""


def run(table: Table) -> None:
    """Add the time of a step and the bytes of the state of both papers' controllers, and the samples at which C and Python differ."""
    for case, name, kind, rate in CONTROLLERS:
        progress.step(f"{case} in C")
        model = load_model(config_path(f"models/{name}.yaml"))
        compensator = build_compensator(model, kind, sample_time=1.0 / rate)
        seconds, state, limit = step_time(compensator, rate, model.units["measurement"])
        table.add("exported", case, "c", "step_time", "us", 1e6 * seconds, n=REPEATS, limit=limit)
        table.add("exported", case, "c", "state_size", "byte", state)
    for case, exported in compared():
        progress.step(f"{case}: {COMPARED} samples in C and in Python")
        table.add("exported", case, "c", "samples_that_differ", "samples", differences(exported), n=COMPARED)


def step_time(compensator: Compensator, rate: float, unit: str) -> tuple[float, int, Limit | None]:
    """Seconds of a step of feedforward and feedback in C (the best of several runs), bytes of the state, and a limit where there is one."""
    axes = len(compensator.axes)
    controller = Controller(PI(0.3, 900.0, 1.0 / rate, 0.0, 50.0, 2e5), axes, FaultResponse(frozen_time=0.0), compensator)
    program = Program("loop", controller.c_code(), axes, *controller.slots(compensator.axes, unit), 1.0 / rate, ("of a benchmark",))
    running = CompiledProgram(program)
    phase = 0.02 * np.arange(ROWS)[:, None] + np.arange(axes)
    reference = 1.0 - 0.9 * np.cos(phase) * np.cos(0.00037 * phase)
    rows = np.concatenate([reference, reference - 0.01 * np.sin(3.1 * phase), np.ones((ROWS, 1))], axis=1)
    running.settle(rows[0])
    found = running.process(rows)
    assert np.all(found[:, -1] == 0.0) and np.ptp(found[:, 0]) > 1.0
    seconds = best_time(lambda: (running.settle(rows[0]), running.process(rows))) / ROWS
    if axes > 1:  # there is none for MHL
        return seconds, running.state.nbytes, None
    compensator.settle(rows[0, :axes])
    limit, command = limits.hampi_step(controller, rows)
    if not np.allclose(command, found[:, 0], rtol=0.0, atol=1e-6):
        raise AssertionError("the two controllers do not compute the same")
    return seconds, running.state.nbytes, limit


def best_time(work: Callable[[], object]) -> float:
    """Seconds of processor time of some work, the best of several runs."""
    best = np.inf
    for _ in range(REPEATS):
        begin = time.thread_time()
        work()
        best = min(best, time.thread_time() - begin)
    return float(best)


def rounds(name: str = "fsm_mhl", kind: str = "mhl", rate: float = 5e3) -> Limit:
    """Rounds per second of a loop whose controller and plant are exported C, with nothing around them."""
    model = load_model(config_path(f"models/{name}.yaml"))
    seconds, *_ = step_time(build_compensator(model, kind, sample_time=1.0 / rate), rate, model.units["measurement"])
    plant = CompiledProgram(simulator(model, 1.0 / rate).program)
    plant.settle(np.zeros(len(model.axes)))
    rows = 50.0 - 40.0 * np.cos(0.02 * np.arange(ROWS)[:, None] + np.arange(len(model.axes)))
    return Limit(1.0 / (seconds + best_time(lambda: plant.process(rows)) / ROWS), "controller and plant in exported C")


def compared() -> tuple[tuple[str, Exported], ...]:
    """Programs that are compared: both papers' plants and feedforwards."""
    hampi, mhl = (load_model(config_path(f"models/{name}.yaml")) for name in ("pea_hampi", "fsm_mhl"))
    return (
        ("hampi plant", simulator(hampi)),
        ("hampi feedforward", feedforward(hampi, FeedforwardOptions("hampi"), reference_ahead=True)),
        ("mhl plant", simulator(mhl)),
        ("mhl feedforward", feedforward(mhl, FeedforwardOptions("mhl"))),
    )


def differences(exported: Exported, samples: int = COMPARED) -> int:
    """Samples of random signals at which C and Python differ in any bit."""
    running, python, spans = CompiledProgram(exported.program), exported.python, exported.spans
    random = np.random.default_rng(1)
    last: Array = np.full(len(spans), 0.5)
    running.settle(spans[:, 0])
    python.settle(spans[:, 0])
    found = 0
    for _ in range(samples // (BLOCK * len(spans))):
        steps = random.normal(0.0, 0.03, (BLOCK, len(spans))) * (random.random((BLOCK, len(spans))) < 0.8)
        walk = last + np.cumsum(steps, axis=0)
        last = walk[-1] % 4.0
        rows = spans[:, 0] + (0.5 + 0.55 * np.sin(0.5 * np.pi * walk)) * (spans[:, 1] - spans[:, 0])  # a little beyond both ends
        found += int(np.count_nonzero(running.process(rows) != python.process(rows)))
    return found
