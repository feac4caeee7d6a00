# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Machines into whose records effects are put, measured and simulated: their records for models and for cases.

- stack (`pea_p885`): stretches of eight cycles, the first two of which fill the memory; tuning seeds see the second file's first half,
  scoring seeds its second half, where an inverse operator shaped the command.
- mirror (`fsm_cubespec`): models from realizations 1-4, tuning seeds see the fifth, scoring seeds the sixth; the other measured period of
  a record is its baseline record.
- `third` and a Bouc-Wen stage, simulated with noise: machines that no family here matches. Only scoring seeds see the Bouc-Wen stage.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from evaluation.blind_test.case_records import respond
from evaluation.blind_test.mirror_models import DELAYS, ORDER, stated_model
from evaluation.blind_test.plant_setups import SETUPS
from evaluation.reproduction import fsm_cubespec_records as mirror
from evaluation.reproduction import pea_p885 as stack
from hyst_control.identify.workflow import identified
from hyst_control.model_file import Model
from hyst_control.records.excitation.excitation import build
from hyst_control.records.record import Record, sampled_record
from hyst_plant_sim.physics import bouc_wen_stage, load_plant

ROWS, FILLING, PERIOD = 1600, 400, 200
"""Rows of the stack's records, of their begin, in which the memory fills, and of a cycle."""
DURATION = 0.8
"""Length of a simulated record, s."""
NOISE = 5e-4
"""Noise of the simulated `third`, rms / stroke."""
MODEL_SEEDS, TUNING_SEEDS, SCORING_SEEDS = (5000, 5001), (5100, 5101, 5102, 5103), (5200, 5201, 5202, 5203, 5204, 5205)
"""Of the simulated records' commands and noise."""
SIMULATED = ("third", "bouc_wen")
PLANTS = ("stack", "mirror", "simulated")
SCORING = 1000
"""First seed that is drawn from the records set apart for scoring."""


@dataclass(frozen=True)
class Machine:
    """Measured machine: its records for models and cases."""

    name: str  # Name of the machine
    axes: tuple[str, ...]  # Names of the axes
    sample_time: float  # Sample time, s
    warm_up: float  # Begin of each record that does not count, s
    cases: tuple[Record, ...]  # Baseline records for cases
    # By the index of a case's record, a clean one of the same command; absent where there is none
    same: Mapping[int, Record]
    others: tuple[Record, ...]  # Baseline records of other commands
    model: Callable[[], Model]  # Identifies the model, with its own error in it


def stack_machine(scoring: bool) -> Machine:
    """Construct the stack."""
    full, nested = stack.load()

    def stretches(record: Record, first: int, last: int, apart: int = ROWS) -> list[Record]:
        how = full.sample_time, full.axes, full.unit, full.hold, "unknown"
        parts = {row: slice(row, row + ROWS) for row in range(first, last - ROWS + 1, apart)}
        return [
            sampled_record(f"{record.name}, row {row}", record.command[part], record.measurement[part], *how)
            for row, part in parts.items()
        ]

    begin = int(np.argmin(full.command[:PERIOD, 0]))  # the same phase in every record: 1 Hz, 200 rows a cycle
    loops, plain, shaped = stretches(full, begin, len(full.command)), stretches(nested, 0, 7300), stretches(nested, 7400, 14155)
    training = [loops[0], plain[0], shaped[0]]
    if scoring:
        # The end of the full cycles, and the shaped loops' middle a cycle apart: what overlaps differs in its memory's filling and phase.
        last = begin + (len(full.command) - begin - ROWS) // PERIOD * PERIOD
        cases = (loops[1], *stretches(full, last, len(full.command)), *stretches(nested, 9000, 12200, PERIOD))
        same = {0: loops[3], 1: loops[3]}
    else:
        cases, same = (loops[2], *plain[1:-1]), {0: loops[3]}

    def model() -> Model:
        return identified(training).model

    return Machine("stack", ("x",), stack.SAMPLE_TIME, FILLING * stack.SAMPLE_TIME, cases, same, (plain[-1], shaped[-1]), model)


def mirror_machine(scoring: bool, level: int) -> Machine:
    """Construct the mirror at one of its levels."""
    data = mirror.load_levels()[level]
    case, other = (mirror.TEST[0], mirror.SELECT[0]) if scoring else (mirror.SELECT[0], mirror.TEST[0])

    def model() -> Model:
        return stated_model(mirror.fit_level(data, ORDER, DELAYS[-1]), data, other, data.name)

    name, warm_up = f"mirror, {mirror.LEVELS[level]} mV", mirror.PERIOD * mirror.SAMPLE_TIME
    records = (data.record(case),), {0: data.record(case, 0)}, (data.record(other, 0),)
    return Machine(name, mirror.AXES, mirror.SAMPLE_TIME, warm_up, *records, model)


def simulated_machine(name: str, scoring: bool) -> Machine:
    """Construct `third` or the Bouc-Wen stage."""
    third = SETUPS["third"]
    drive = (third.sample_time, third.command), (bouc_wen_stage.SAMPLE_TIME, bouc_wen_stage.COMMAND)
    step, (low, high) = drive[name != "third"]

    def record(seed: int) -> Record:
        excitation = {"signal": "diagnostic", "lowest": low, "highest": high, "duration": DURATION, "seed": seed}
        rows = np.clip(build(excitation, step, 1), low, high)
        if name == "third":
            plant = load_plant({"plant": name, "rating": [low, high]}, seed=seed, sample_time=step, noise=NOISE * third.stroke)
            measured = respond(plant, rows)
        else:
            measured = bouc_wen_stage.respond(rows, seed)
        return sampled_record(f"{name}, seed {seed}", rows, measured, step, ("x",), "um", start="settled")

    def model() -> Model:
        return identified([record(seed) for seed in MODEL_SEEDS]).model

    cases = tuple(record(seed) for seed in (SCORING_SEEDS if scoring else TUNING_SEEDS))
    return Machine(name, ("x",), step, 0.0, cases, {}, (), model)


def machines_of(plants: Sequence[str], scoring: bool) -> list[Machine]:
    """List the machines of some of `PLANTS`."""
    names = ["stack"] if "stack" in plants else []
    names += [f"mirror, {level} mV" for level in mirror.LEVELS] if "mirror" in plants else []
    names += SIMULATED[: 2 if scoring else 1] if "simulated" in plants else []
    return [machine_of(name, scoring) for name in names]


@cache
def machine_of(name: str, scoring: bool) -> Machine:
    """Find a machine by its name; its model is identified once."""
    if name == "stack":
        machine = stack_machine(scoring)
    elif name in SIMULATED:
        machine = simulated_machine(name, scoring)
    else:
        machine = mirror_machine(scoring, next(i for i, level in enumerate(mirror.LEVELS) if name == f"mirror, {level} mV"))
    return replace(machine, model=cache(machine.model))
