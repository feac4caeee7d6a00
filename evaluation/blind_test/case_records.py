# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Records of the blind test's cases: the reference simulation of a case under its excitation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

import numpy as np

from evaluation.blind_test.case import Case
from evaluation.blind_test.plant_setups import FILE, SCATTER, SETUPS, scatter
from hyst_control.base.arrays import Array
from hyst_control.control.feedback.loop import run_loop
from hyst_control.control.feedback.pi import PI
from hyst_control.records.excitation.excitation import build
from hyst_control.records.record import Record, Signal
from hyst_plant_sim.physics import Plant, load_plant


def commands(case: Case) -> Annotated[Array, "N A"]:
    """Construct the excitation of a case."""
    setup = SETUPS[case.plant]
    axes = 2 if case.plant.startswith("fsm") else 1
    low, high = setup.command
    span, center, random = high - low, 0.5 * (high + low), np.random.default_rng([case.seed, 1])
    spec: dict[str, Any] = dict(FILE["excitations"][case.excitation])
    if case.excitation == "rich":
        spec |= {"lowest": low, "highest": high, "seed": int(random.integers(3)), "duration": case.duration}
    elif case.excitation == "multisine":
        spec |= {"rms": 0.13 * span, "offset": center, "seed": int(random.integers(3))}
    elif case.excitation == "sine":
        spec |= {"frequency": float(random.choice([5.0, 12.0, 35.0, 90.0])), "amplitude": 0.42 * span, "offset": center}
    else:
        spec |= {"offset": 0.5 * setup.stroke, "amplitudes": [share * setup.stroke for share in (0.2, 0.08, 0.08)]}
    rows = build(spec, setup.sample_time, axes)
    if case.excitation != "closed_loop":
        return np.clip(rows, low, high)
    # A record starts at rest: the loop is closed at a reference of 0.
    ramp = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, int(0.1 / setup.sample_time)))
    return np.concatenate([np.zeros((20, axes)), ramp[:, None] * rows[0], rows])


def respond(plant: Plant, rows: Annotated[Array, "N A"]) -> Annotated[Array, "N A"]:
    """Measurement of a plant that starts settled at the first row of its command."""
    return np.concatenate([plant.reset(rows[0])[None], plant.step(rows)[:-1]])


def run_case(case: Case, **included: bool) -> dict[str, Array]:
    """Simulate a case."""
    truth = plant_of(case, **included)
    rows, setup = commands(case), SETUPS[case.plant]
    if case.excitation != "closed_loop":
        return {"command": rows, "measurement": respond(truth, rows)}
    controller = PI(setup.gains[0], setup.gains[1], setup.sample_time, setup.command[0], setup.command[1]).start(rows.shape[1])
    signals = run_loop(rows, None, controller, truth)
    return {name: signals[name] for name in ("reference", "feedforward", "feedback", "command", "measurement")}


def plant_of(case: Case, effects: bool = True, noisy: bool = True, scattered: bool = True, later: bool = False) -> Plant:
    """Construct the reference simulation of a case, rated for the range in which it is driven."""
    # later: another session of the same plant: noise, lost samples, and the phases of the mains and of vibrations are others
    changes = scatter(case.plant, case.seed, SCATTER * case.off if scattered else 0.0)
    seed = int(np.random.default_rng([case.seed, 4]).integers(1 << 31)) if later else case.seed
    return truth(case.plant, case.effects if effects else (), changes, seed, case.noise if noisy else 0.0)


def truth(plant: str, effects: Sequence[Mapping[str, Any]], changes: Mapping[str, Any], seed: int, noise: float) -> Plant:
    """Construct a reference simulation with effects and changed coefficients; noise: rms / stroke."""
    setup = SETUPS[plant]
    document: dict[str, Any] = {"plant": plant, "rating": list(setup.command), "stroke": [0.0, setup.stroke]}
    document["effects"] = [dict(effect) for effect in effects]
    return load_plant(document, seed=seed, sample_time=setup.sample_time, **{**changes, "noise": noise * setup.stroke})


def record_of(case: Case, signals: Mapping[str, Array]) -> Record:
    """Convert a case's signals to a record, which holds nothing of the case's label."""
    time = np.arange(len(signals["command"]), dtype=np.float64) * SETUPS[case.plant].sample_time
    axes = ("x", "y") if case.plant.startswith("fsm") else ("x",)
    unit = "mrad" if case.plant.startswith("fsm") else "um"
    units = {"command": "V", "feedforward": "V", "feedback": "V"}
    return Record({name: Signal(time, values, axes, units.get(name, unit)) for name, values in signals.items()}, case.name)
