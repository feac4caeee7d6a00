# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Round trip of every family: a known plant of it, records as laboratories have them, its identification, and another session.

Records begin amid a motion, with a sensor's zero of 5 % of the range, a drift of 2 % and 12-bit rounding; the truth is a chain of the
family's own stages, so what is left is what these cost.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from hyst_control.base import progress
from hyst_control.base.arrays import Array
from hyst_control.chain import Chain, Parallel, Stage
from hyst_control.chain.hysteresis.madelung import Madelung
from hyst_control.chain.hysteresis.prandtl_ishlinskii import ModifiedPrandtlIshlinskii, PrandtlIshlinskii
from hyst_control.chain.hysteresis.rate_dependent_prandtl_ishlinskii import RateDependentPrandtlIshlinskii
from hyst_control.chain.linear.linear_stages import Delay, RateCorrection, TransferFunction
from hyst_control.chain.memoryless import Offset
from hyst_control.identify import Fit, identify
from hyst_control.identify.assess.fit_report import record_rows
from hyst_control.identify.data.initial_memory import with_beginning
from hyst_control.model_file import Model, simulate
from hyst_control.records.record import Record, sampled_record
from hyst_control.reporting.tables import Table
from hysteretic_oscillators.stages.bouc_wen import BoucWen
from hysteretic_oscillators.stages.duhem import Duhem
from hysteretic_oscillators.stages.duhem_oscillator import DuhemOscillator

MIDDLE, SWING = 5.0, 40.0
"""Drive, V."""
BITS = 12


@dataclass(frozen=True)
class Plant:
    """A known plant of a family."""

    stages: tuple[Stage, ...]  # Its chain
    sample_time: float  # Of the records, s
    # Options of the identification that say where the family is right; the structure of G(s) is left to it
    options: Mapping[str, object] = field(default_factory=dict)
    pace: float = 20.0  # Factor of the frequencies of the drive: families with dynamics are excited faster
    seconds: float = 0.2  # Length of every frequency, s at a pace of 1

    @property
    def model(self) -> Model:
        """The plant as a model."""
        return Model("plant", ("x",), {"command": "V", "measurement": "um"}, self.sample_time, Chain(self.stages))


_W = 2 * np.pi * 700.0
_MODE = TransferFunction([_W * _W], [1.0, 0.6 * _W, _W * _W])
_DELAY = Delay(1.3e-4)
_THRESHOLDS, _WEIGHTS = (0.0, 3.0, 7.0, 12.0), (0.055, 0.012, 0.010, 0.008)
_CURVES = Madelung([0.2, 0.5, 0.3], [-0.3, -0.2, 1.5], 90.0, 2.0, input_offset=-40.0)
_PLAYS = {"thresholds": _THRESHOLDS}
_OSCILLATOR = 10.0 / _W**2, 6.0 / _W, 6.0

PLANTS = {
    "bouc_wen": Plant((BoucWen(*_OSCILLATOR, 4.0, 0.5, -0.2),), 1e-4),
    "duhem": Plant((_DELAY, Duhem(0.1, -0.03, 0.03, -0.008, 1.3, 4e-3), _MODE), 1e-4, {"creep": False}),
    "duhem_oscillator": Plant((DuhemOscillator(*_OSCILLATOR, [-3.0, 0.0, 3.0], [4.5, 4.0, 2.5], [2.5, 4.0, 4.5]),), 1e-4),
    "hampi": Plant(
        (ModifiedPrandtlIshlinskii(_THRESHOLDS, _WEIGHTS, m1=2e-7, m2=1e-7, k=-4e-5, b=0.001), _DELAY, _MODE), 1e-4, _PLAYS
    ),
    "hapi": Plant((PrandtlIshlinskii(_THRESHOLDS[1:], _WEIGHTS[1:], w0=_WEIGHTS[0]), _DELAY, _MODE), 1e-4, _PLAYS),
    "linear": Plant(
        (Delay(2e-4), TransferFunction([0.05 * _W * _W], [1.0, 0.1 * _W, _W * _W])),
        1e-4,
        {"order": 2, "delay": 2e-4, "direct": False},
    ),
    "madelung": Plant((_CURVES, Offset(0.4)), 1e-3, {"degree": 3}, pace=1.0),
    "mhl": Plant((_DELAY, Parallel(((_CURVES,), (RateCorrection(k1=-2e-5, k2=1e-3),))), _MODE), 1e-4, {"degree": 3}),
    "pi": Plant((PrandtlIshlinskii(_THRESHOLDS[1:], _WEIGHTS[1:], w0=_WEIGHTS[0]),), 1e-3, _PLAYS, pace=1.0),
    "rdpi": Plant((RateDependentPrandtlIshlinskii(_THRESHOLDS, _WEIGHTS, beta=2e-4),), 1e-4, _PLAYS),
}


def run(table: Table) -> None:
    """Identify every family from one such record and predict another session."""
    for name in PLANTS:
        progress.step(f"round trip of {name}")
        examiner = with_beginning(fresh(name))
        row = record_rows(identified(name).model, [examiner])[0][0]
        for quantity in ("nrmse_own_zero", "nrmse_centered", "nrmse"):
            table.add(
                "round trips", "bipolar, unknown beginning, zero, drift, 12 bits", name, quantity, "% of range", row[quantity], n=1
            )


def identified(name: str) -> Fit:
    """Identify a family from the record that teaches it."""
    return identify([taught(name)], name, "joint", **PLANTS[name].options)


def sines(sample_time: float, seconds: float, *cycles: tuple[float, float]) -> Annotated[Array, "N 1"]:
    """Whole sines about the middle of the drive, a short rest behind each."""
    parts = []
    for frequency, amplitude in cycles:
        count = max(round(seconds * frequency), 2)
        time = np.arange(round(count / frequency / sample_time)) * sample_time
        parts += [MIDDLE + amplitude * np.sin(2 * np.pi * frequency * time), np.full(round(0.02 / sample_time), MIDDLE)]
    return np.concatenate(parts)[:, None]


def session(name: str, label: str, zero: float, drift: float, *cycles: tuple[float, float]) -> Record:
    """Record `cycles` from amid the first of them, as a laboratory has it."""
    plant = PLANTS[name]
    sample_time, pace = plant.sample_time, plant.pace
    warm = sines(sample_time, plant.seconds, (2.0 * pace, SWING), (3.0 * pace, 25.0))
    driven = sines(sample_time, plant.seconds, *((frequency * pace, amplitude) for frequency, amplitude in cycles))
    command = np.concatenate([warm, driven])
    measurement = simulate(plant.model, command)
    cut = len(warm) + round(0.13 / cycles[0][0] / pace / sample_time)
    command, measurement = command[cut:], measurement[cut:]
    span = float(np.ptp(measurement))
    measurement = measurement + span * (zero + drift * np.linspace(0.0, 1.0, len(measurement))[:, None])
    step = 1.25 * span / 2**BITS
    return sampled_record(label, command, step * np.rint(measurement / step), sample_time, ("x",), "um", start="auto")


def taught(name: str) -> Record:
    """Record from which a family is identified."""
    return session(
        name, "fitted", 0.05, 0.02, (1.0, 30.0), (2.0, 40.0), (2.0, 25.0), (4.0, 15.0), (4.0, 40.0), (20.0, 32.0), (1.0, 10.0)
    )


def fresh(name: str) -> Record:
    """Record of another session: other amplitudes and frequencies, other zero, other drift."""
    return session(name, "held out", -0.04, -0.015, (1.5, 20.0), (3.0, 38.0), (2.5, 28.0), (12.0, 30.0), (5.0, 33.0))
