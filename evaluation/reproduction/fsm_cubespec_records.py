# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Records of the measured mirror (`fsm_cubespec`), the linear model of a level, and the error of a model on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from evaluation.reproduction.measured_data import data_folder, read_array
from evaluation.reproduction.periodic_fit import refined
from evaluation.reproduction.softening_modes import Level as Periods
from evaluation.reproduction.softening_modes import spectra
from hyst_control.base.arrays import Array
from hyst_control.chain.chain import Chain
from hyst_control.identify.modal.modal_candidate import Candidate, error_of, stages_of
from hyst_control.identify.modal.modal_fit import subspace
from hyst_control.identify.modal.modal_model import ModalModel, Spectra
from hyst_control.model_file import Model, simulate
from hyst_control.records.record import Record, sampled_record

SAMPLE_TIME = 1.0 / 6400.0
PERIOD = 8192
AXES = ("a", "b", "c")
LEVELS = (100, 200, 300)
"""Excitation levels in mV rms."""
FIT, SELECT, TEST = (0, 1, 2, 3), (4,), (5,)
INITIALIZATION = 100
"""First samples of a period that do not count in the benchmark's own measure: a model may find its state from them."""


@dataclass(frozen=True)
class Level:
    """Records of one level: command (8192, 3, 6, 2) in V and measurement (8192, 3, 6, 2) in um."""

    name: str
    command: Array
    measurement: Array

    @property
    def largest(self) -> float:
        """Largest command, V."""
        return float(np.abs(self.command).max())

    def periods(self, realisations: Sequence[int]) -> Periods:
        """Both periods averaged."""
        return Periods(self.command[:, :, realisations].mean(axis=3), self.measurement[:, :, realisations].mean(axis=3))

    def spectra(self, realisations: Sequence[int], weight: float = 1.0) -> Spectra:
        """Compute the spectra at the excited lines, both periods averaged."""
        periods = self.periods(realisations)
        return spectra(periods.command, periods.measurement, weight)

    def record(self, realization: int, last: int = 1) -> Record:
        """Join both periods of a realization; the first brings a simulation into its steady state, and the `last` may be either."""
        command, measurement = (
            np.concatenate([rows[:, :, realization, 1 - last], rows[:, :, realization, last]])
            for rows in (self.command, self.measurement)
        )
        return sampled_record(f"{self.name}, realization {realization + 1}", command, measurement, SAMPLE_TIME, AXES, "um")

    def error(self, simulated: Annotated[Array, "8192 3 R"], realisations: Sequence[int]) -> Annotated[Array, "4"]:
        """Compute relative errors of a simulation."""
        measured = self.measurement[:, :, realisations]
        squared = np.mean((measured - simulated[..., None]) ** 2, axis=(0, 2, 3))
        power = np.mean(measured**2, axis=(0, 2, 3))
        errors: Array = 100.0 * np.sqrt(np.concatenate([[squared.sum() / power.sum()], squared / power]))
        return errors

    def rms_errors(self, simulated: Annotated[Array, "8192 3 R"], realisations: Sequence[int]) -> Annotated[Array, "3 R 2"]:
        """Compute the benchmark's own measure: the rms error in um of every output, realization and period."""
        left = (self.measurement[:, :, realisations] - simulated[..., None])[INITIALIZATION:]
        errors: Array = np.sqrt(np.mean(left**2, axis=0))
        return errors


def load_levels() -> list[Level]:
    """Load the measurements of all levels."""
    folder = data_folder("fsm_cubespec")
    levels = []
    for level in LEVELS:
        command, measurement = (read_array(folder / f"{letter}_{level}mV_train.npy", PERIOD, 3, 6, 2) for letter in "uy")
        levels.append(Level(f"{level} mV", command, 1e6 * measurement))
    return levels


def fit_level(level: Level, order: int, delay: float = 0.0) -> Candidate:
    """Fit a level's linear model on realizations 1-4 and evaluate it on the fifth."""
    data = [level.spectra(FIT)]
    fit = refined(data, subspace(data, [order], np.full(3, delay), "zoh")[0], 25)
    return replace(fit, held_out=error_of(fit.model, [level.spectra(SELECT)]))


def model_of(modal: ModalModel, name: str, command: float) -> Model:
    """Convert a modal model to the content of a model file."""
    return Model(
        name=name,
        axes=AXES,
        units={"command": "V", "measurement": "um"},
        sample_time=SAMPLE_TIME,
        hold=modal.hold,
        chain=Chain(tuple(stages_of(modal, SAMPLE_TIME))),
        valid={"command": [-command, command], "frequency": [0.0, 3000.0]},
    )


def steady_state(model: Model, command: Annotated[Array, "8192 3 R"]) -> Annotated[Array, "8192 3 R"]:
    """Simulate the steady period for periodic commands: the period runs twice, and the second run counts."""
    simulated = [simulate(model, np.tile(command[:, :, r], (2, 1)))[PERIOD:] for r in range(command.shape[2])]
    return np.stack(simulated, axis=2)


def simulation_error(model: Model, level: Level, realisations: Sequence[int]) -> Annotated[Array, "4"]:
    """Compute the relative errors of a model simulated from the command alone."""
    return level.error(steady_state(model, level.command[:, :, realisations].mean(axis=3)), realisations)


def response_error(
    response: np.ndarray, lines: Annotated[Array, "F"], level: Level, realisations: Sequence[int]
) -> Annotated[Array, "4"]:
    """Compute the relative errors of a nonparametric frequency response."""
    u = np.fft.rfft(level.command[:, :, realisations].mean(axis=3), axis=0)
    y = np.zeros_like(u)
    y[lines] = np.einsum("koj,kjr->kor", response, u[lines])
    return level.error(np.fft.irfft(y, PERIOD, axis=0), realisations)
