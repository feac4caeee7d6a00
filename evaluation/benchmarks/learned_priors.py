# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Worth of a population's model: verdicts on new units with the fleet's usual scatter, and with the tolerance of a single unit."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.config_files import config_path
from hyst_control.chain import Chain
from hyst_control.chain.coordinates import chain_coordinates, with_coordinates
from hyst_control.diagnose.run.diagnosis import diagnose
from hyst_control.diagnose.verdict import Verdict
from hyst_control.fleet.population_model import population_model
from hyst_control.model_file import Model, load_model, simulate
from hyst_control.records.record import Record, Signal
from hyst_control.reporting.tables import Table

GAIN, SCATTER, ERROR, NOISE = "transfer_function.gain", 0.03, 0.002, 3e-3
"""The coefficient that scatters, its relative scatter from unit to unit, its error as identified, and the sensor's noise (um)."""
KNOWN, NEW, SAMPLE_TIME, SAMPLES = 24, 12, 1e-4, 1000
TIMES = 3.0
"""Size of the true effect, a delay, in unit-to-unit scatters of the measurement."""


def run(table: Table, new: int = NEW) -> None:
    """Diagnose new units, healthy ones and ones with a delay, with both models."""
    random = np.random.default_rng(24)
    nominal = load_model(config_path("models/pea_hampi.yaml"))
    units = [_unit(nominal, gain) for gain in 1.0 + SCATTER * random.standard_normal(KNOWN)]
    with tempfile.TemporaryDirectory() as folder:
        names = [f"u{index}" for index in range(KNOWN)]
        fleet = population_model(units, names, np.zeros(KNOWN), Path(folder) / "fleet.yaml").model
    command = 25.0 - 25.0 * np.cos(2 * np.pi * 40.0 * SAMPLE_TIME * np.arange(SAMPLES))[:, None]
    moving = simulate(nominal, command, SAMPLE_TIME)
    wanted = TIMES * SCATTER * float(np.sqrt(np.mean(moving**2)))
    delay = next(count for count in range(1, SAMPLES) if _delay_gap(moving, count) >= wanted)
    gains = 1.0 + SCATTER * random.standard_normal(new)
    for name, model in (("population's model", fleet), ("one unit's model", units[0])):
        false, found = 0, 0
        for gain in gains:
            healthy = simulate(_unit(nominal, gain), command, SAMPLE_TIME)
            false += _verdict(model, command, healthy, random) is not Verdict.NO_GAP
            found += _names_delay(model, command, np.concatenate([healthy[:1].repeat(delay, 0), healthy[:-delay]]), random)
        table.add("learned priors", "healthy new units", name, "verdicts other than no_gap", "1", false / new, n=new)
        case = f"delay of {TIMES:g} unit-to-unit scatters"
        table.add("learned priors", case, name, "delay named", "1", found / new, n=new)


def _unit(nominal: Model, gain: float) -> Model:
    """A unit's model, as an identification of it would state it."""
    value = gain * chain_coordinates(nominal.chain.stages, nominal.axes)[GAIN].value
    stages = with_coordinates(nominal.chain.stages, {GAIN: value}, nominal.axes)
    uncertainty = {"parameters": [GAIN], "factor": [[abs(ERROR * value)]]}
    return replace(nominal, chain=Chain(stages), tolerance={}, uncertainty=uncertainty)


def _delay_gap(moving: Array, count: int) -> float:
    return float(np.sqrt(np.mean((moving[count:] - moving[:-count]) ** 2)))


def _record(command: Array, measured: Array, random: np.random.Generator) -> Record:
    time = SAMPLE_TIME * np.arange(len(command), dtype=np.float64)
    noisy = measured + NOISE * random.standard_normal(measured.shape)
    return Record({"command": Signal(time, command, ("x",), "V"), "measurement": Signal(time, noisy, ("x",), "um")}, "made")


def _verdict(model: Model, command: Array, measured: Array, random: np.random.Generator) -> Verdict:
    [part] = diagnose([_record(command, measured, random)], model).parts
    return part.decision.verdict


def _names_delay(model: Model, command: Array, measured: Array, random: np.random.Generator) -> bool:
    [part] = diagnose([_record(command, measured, random)], model).parts
    return part.decision.verdict is Verdict.EFFECT and "delay" in part.chosen.names
