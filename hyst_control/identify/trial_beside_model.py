# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A record as it is checked beside a model: what the model makes of it, its modes and its delay."""

from __future__ import annotations

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.chain.linear.linear_stages import Delay, LinearStage
from hyst_control.identify.assess.free_motion import ROWS, ending_dynamics, free_motion, moves_already, states_of
from hyst_control.model_file import Model, simulate
from hyst_control.records.validity.findings import Simulation, Trial

LIGHT = 0.3  # Damping up to which a pair of poles is a mode


def trial_beside(model: Model, name: str, command: Array, measurement: Array, sample_time: float, hold: str | None) -> Trial:
    """A record of command and measurement (N, A) with what a model makes of its command."""
    simulate_at = simulation(model, hold)
    simulated = simulate_at(command, sample_time)
    shown = simulated + _from_before(model, measurement - simulated, sample_time, hold) if np.isfinite(simulated).all() else None
    unit = model.units["measurement"]
    return Trial(name, command, measurement, sample_time, tuple(model.axes), shown, unit, simulate_at, *modes_and_delay(model))


def _from_before(model: Model, error: Array, sample_time: float, hold: str | None) -> Array:
    """Motion (N, A) of the model's dynamics that goes on from before the record, where that is most of the error; else none."""
    dynamics, found = ending_dynamics(model, sample_time, hold or model.hold), np.zeros_like(error)
    if dynamics is not None:
        early, coupled = error[:ROWS], len(dynamics.a) == 1
        motion = free_motion(dynamics, len(early))
        if moves_already(motion, early, coupled):
            found[:ROWS] = np.einsum("ina,ia->na", motion, states_of(motion, early, coupled))
    return found


def simulation(model: Model, hold: str | None) -> Simulation:
    """A model at any command and sample time; not a number where it does not run."""

    def simulated(command: Array, sample_time: float) -> Array:
        try:
            with np.errstate(all="ignore"):
                return simulate(model, command, sample_time, hold)
        except InputError:
            return np.full_like(command, np.nan)

    return simulated


def modes_and_delay(model: Model) -> tuple[tuple[float, ...], float]:
    """Frequencies (Hz) of a model's lightly damped modes, and its delay in s, the largest of the axes'."""
    delay = sum(float(np.max(stage.tau)) for stage in model.chain.stages if isinstance(stage, Delay))
    systems = [each for stage in model.chain.stages if isinstance(stage, LinearStage) for each in stage.systems(len(model.axes))]
    poles = np.concatenate([np.zeros(0), *(np.linalg.eigvals(each.A) for each in systems)])
    modes = {float(f"{abs(pole) / (2.0 * np.pi):.9g}") for pole in poles if pole.imag > 0 and -pole.real < LIGHT * abs(pole)}
    return tuple(sorted(modes)), delay
