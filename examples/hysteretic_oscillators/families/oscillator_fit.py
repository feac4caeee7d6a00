# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Identification of mechanics with a hysteretic force in their feedback, the common part of such families.

The simulation error of the whole oscillator is minimized (`simulation_error`). The search begins at the linear oscillator that the
records' spectra show, whose stiffness is then shared between the spring and the force.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Protocol

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.chain import Stage
from hyst_control.chain.memoryless import Offset
from hyst_control.chain.parameter import Scattering
from hyst_control.chain.stage import Sampling
from hyst_control.identify.assess.assembly import AxisFit
from hyst_control.identify.assess.fit_report import SPECTRUM_ROWS, command_bandwidth
from hyst_control.identify.data.fit import Number
from hyst_control.identify.data.fit_windows import whole_records, with_sign
from hyst_control.identify.mhl.madelung import mean_offset, turned_by
from hyst_control.identify.solve.gram_sums import Window
from hyst_control.identify.solve.simulation_error import Parametrization, Solution, driving_signal, minimize_simulation_error
from hyst_control.records.record import Record
from hyst_control.records.stream.row_store import blocks, spread_parts
from hysteretic_oscillators.stages.hysteretic_oscillator import HystereticOscillator, OscillatorFilter

SELECTION_ROWS = 200_000
"""Rows on which starts and structures are compared."""
STRONG_LINE = 1e-3
"""Power of a line of the command relative to the strongest one from which on it counts for the linear start."""
DAMPING_RATIOS = (1e-4, 20.0)


@dataclass(frozen=True)
class Linear:
    """Linear oscillator k y + c ẏ + m ÿ = u."""

    stiffness: float  # K, V/measurement unit
    frequency: float  # Natural frequency, rad/s
    damping: float  # Damping ratio
    travel: float  # Range of the measurement, the scale of the displacement
    sign: float  # -1 where the measurement falls as the command rises, else 1

    @property
    def mechanics(self) -> tuple[float, float]:
        """Mass and damping of the stage."""
        return self.stiffness / self.frequency**2, 2.0 * self.damping * self.stiffness / self.frequency


def linear_start(records: Sequence[Record], axis: int) -> Linear:
    """Estimate a linear oscillator from the spectra of the records, a linear least-squares problem in k, c and m."""
    matrix, vector = np.zeros((3, 3)), np.zeros(3)
    for data in records:
        for part in spread_parts(len(data.command), SPECTRUM_ROWS):
            command, measurement = data.command[part, axis], data.measurement[part, axis]
            window = np.hanning(len(command))
            u, y = (np.fft.rfft(window * (signal - signal.mean())) for signal in (command, measurement))
            if data.hold == "zoh":  # the sample at t_k answers the commands before it: half an interval later on the average
                u *= np.exp(-1j * np.pi * np.arange(len(u)) / len(command))
            strong = np.abs(u) ** 2 > STRONG_LINE * np.max(np.abs(u[1:]) ** 2)
            strong[0] = False
            omega = 2 * np.pi * np.flatnonzero(strong) / (len(command) * data.sample_time)
            columns = np.stack([y[strong], 1j * omega * y[strong], -(omega**2) * y[strong]], axis=1)
            matrix += (columns.conj().T @ columns).real
            vector += (columns.conj().T @ u[strong]).real
    travel = max(float(np.ptp(data.measurement[:, axis])) for data in records)
    drive = max(float(np.ptp(data.command[:, axis])) for data in records)
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    stiffness, damping, mass = np.linalg.lstsq(matrix / scale / scale[:, None], vector / scale, rcond=1e-12)[0] / scale
    sign = -1.0 if stiffness < 0 else 1.0
    stiffness, damping, mass = sign * stiffness, sign * damping, sign * mass
    band = 2 * np.pi * max(command_bandwidth(data.command, data.sample_time) for data in records)
    fastest = np.pi / min(data.sample_time for data in records)
    if not stiffness > 0:
        stiffness = drive / travel
    frequency = float(np.sqrt(stiffness / mass)) if mass > 0 else 3.0 * band
    frequency = float(np.clip(frequency, 0.01 * band, 0.5 * fastest))
    ratio = 0.5 * damping * frequency / stiffness
    return Linear(float(stiffness), frequency, float(np.clip(ratio if ratio > 0 else 0.5, *DAMPING_RATIOS)), travel, sign)


class Law(Protocol):
    """A family's parameters behind log stiffness, log frequency and log damping ratio, and the stage that all of them make."""

    @property
    def size(self) -> int:
        """Number of parameters."""

    @property
    def lhs(self) -> Array:
        """Left sides (C, size) of the constraints on them."""

    @property
    def rhs(self) -> Array:
        """Right sides (C,)."""

    def stage(self, linear: Linear, vector: Array) -> HystereticOscillator:
        """Construct the stage of one axis."""


@dataclass(frozen=True)
class Problem:
    """One axis of all records with its scales."""

    windows: Sequence[Window]  # The records; the measurement turned where it falls as the command rises
    linear: Linear  # The linear oscillator at which the first three parameters are 0
    nuisance: str  # Addition of each record, one of `gram_sums.NUISANCES`

    def stage(self, law: Law, vector: Array) -> HystereticOscillator:
        """The stage of a parameter vector."""
        stiffness, frequency, damping = np.array([self.linear.stiffness, self.linear.frequency, self.linear.damping]) * np.exp(
            vector[:3]
        )
        return law.stage(replace(self.linear, stiffness=stiffness, frequency=frequency, damping=damping), vector[3:])

    def fit(
        self, law: Law, start: Annotated[Array, "P"], *, passes: int, everything: bool = False, tolerance: float = 1e-4
    ) -> Solution:
        """Minimize the simulation error from a start."""
        lhs = np.hstack([np.zeros((len(law.lhs), 3)), law.lhs])
        parametrization = Parametrization(lambda vector: (self.stage(law, vector),), lhs, law.rhs)
        return minimize_simulation_error(
            self.windows, parametrization, start, nuisance=self.nuisance, passes=passes, everything=everything, tolerance=tolerance
        )

    @property
    def selection(self) -> Problem:
        """The same on the beginnings of the records: the state of an oscillator amid one is not known from its command's turns."""
        total = sum(len(window.command) for window in self.windows)
        if total <= SELECTION_ROWS:
            return self
        share = SELECTION_ROWS / total
        lengths = [max(int(share * len(window.command)), window.skip + 1) for window in self.windows]
        windows = [
            replace(window, command=window.command[:length], measurement=window.measurement[:length], weight=None, share=share)
            for window, length in zip(self.windows, lengths, strict=True)
        ]
        return replace(self, windows=windows)

    def force_range(self, law: Law, vector: Annotated[Array, "P"]) -> tuple[float, float]:
        """Least and greatest force over the records."""
        ranges = []
        for window in self.windows:
            signal, _ = driving_signal(window)
            running = OscillatorFilter(self.stage(law, vector), 1, Sampling(window.sample_time, 1, window.hold))
            running.settle(signal[0])
            for part in blocks(len(signal)):
                running.process(signal[part])
            ranges.append(running.force_range[0])
        return min(float(low) for low, _ in ranges), max(float(high) for _, high in ranges)


def problem_of(records: Sequence[Record], axis: int, nuisance: str) -> Problem:
    """Set up the fit of one axis."""
    linear = linear_start(records, axis)
    windows = [with_sign(window, linear.sign) for window in whole_records(records, axis, weighted=False)]
    return Problem(windows, linear, nuisance)


def axis_fit(problem: Problem, law: Law, solution: Solution, held_out: float, given: Sequence[str] = ()) -> AxisFit:
    """The fit of one axis; given: names of parameters that were not fitted."""
    sign = problem.linear.sign
    zero = sign * mean_offset(solution, problem.windows, problem.nuisance)
    rest = [*turned_by(sign), *([Offset(zero)] if zero else [])]

    def numbers(vector: Array) -> list[Number]:
        stage = problem.stage(law, vector)
        known = stage.declarations()
        return [Number(f"{name}{place}", value, known[name].unit) for name, place, value in scattering(stage) if name not in given]

    return AxisFit(lambda vector: [problem.stage(law, vector), *rest], solution.parameters, solution.covariance, numbers, held_out)


def scattering(stage: Stage) -> Iterator[tuple[str, str, float]]:
    """Name, place in a list and value of the numbers of a stage of one axis that scatter."""
    for name, declaration in stage.declarations().items():
        value = getattr(stage, name)
        if declaration.scatter is not Scattering.NONE:
            yield from ((name, f"[{i}]", item) for i, item in enumerate(value)) if isinstance(value, tuple) else [(name, "", value)]
