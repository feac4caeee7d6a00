# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Identification of mechanics with a hysteretic force in their feedback, the common part of such families.

The simulation error of the whole oscillator is minimized (`simulation_error`). The search begins at the linear oscillator that the
records' spectra show, whose stiffness is then shared between the spring and the force.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Annotated, Protocol

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.chain import Stage
from hyst_control.chain.memoryless import Gain, Offset
from hyst_control.chain.parameter import Scattering
from hyst_control.chain.stage import Sampling
from hyst_control.identify.assess.assembly import assembled, chain_model
from hyst_control.identify.assess.fit_report import SPECTRUM_ROWS, command_bandwidth
from hyst_control.identify.data.dataset import Dataset, Fit, ParameterRow
from hyst_control.identify.data.fit_windows import whole_records, with_sign
from hyst_control.identify.mhl.madelung import mean_offset
from hyst_control.identify.solve.gram_sums import Window
from hyst_control.identify.solve.parameter_covariance import Uncertainty, independent_axes
from hyst_control.identify.solve.simulation_error import Parametrization, Solution, driving_signal, minimize_simulation_error
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


def linear_start(datasets: Sequence[Dataset], axis: int) -> Linear:
    """Estimate a linear oscillator from the spectra of the records, a linear least-squares problem in k, c and m."""
    matrix, vector = np.zeros((3, 3)), np.zeros(3)
    for data in datasets:
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
    travel = max(float(np.ptp(data.measurement[:, axis])) for data in datasets)
    drive = max(float(np.ptp(data.command[:, axis])) for data in datasets)
    scale = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    stiffness, damping, mass = np.linalg.lstsq(matrix / scale / scale[:, None], vector / scale, rcond=1e-12)[0] / scale
    sign = -1.0 if stiffness < 0 else 1.0
    stiffness, damping, mass = sign * stiffness, sign * damping, sign * mass
    band = 2 * np.pi * max(command_bandwidth(data) for data in datasets)
    fastest = np.pi / min(data.sample_time for data in datasets)
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


def problem_of(datasets: Sequence[Dataset], axis: int, nuisance: str) -> Problem:
    """Set up the fit of one axis."""
    linear = linear_start(datasets, axis)
    windows = [with_sign(window, linear.sign) for window in whole_records(datasets, axis, weighted=False)]
    return Problem(windows, linear, nuisance)


@dataclass(frozen=True)
class AxisFit:
    """A fit of one axis."""

    problem: Problem  # What was fitted
    law: Law  # Of the branches
    solution: Solution  # From all rows
    held_out: float  # Mean square error on the rows held out, while they were
    given: tuple[str, ...] = ()  # Names of parameters that were given and not fitted

    @property
    def stage(self) -> HystereticOscillator:
        """The fitted stage."""
        return self.problem.stage(self.law, self.solution.parameters)

    @property
    def offset(self) -> float:
        """Mean of the records' offsets, measurement unit."""
        return self.problem.linear.sign * mean_offset(self.solution, self.problem.windows, self.problem.nuisance)

    def rows(self) -> list[ParameterRow]:
        """Every parameter that was fitted, with its standard error."""
        vector = self.solution.parameters
        nominal = numbers(self.stage)
        neighbors = [numbers(self.problem.stage(self.law, vector + 1e-6 * unit)) for unit in np.eye(len(vector))]
        jacobian = np.array([[(neighbor[name] - value) / 1e-6 for neighbor in neighbors] for name, value in nominal.items()])
        errors = np.sqrt(np.maximum(np.diag(jacobian @ self.solution.covariance @ jacobian.T), 0.0))
        known = self.stage.declarations()
        return [
            {"name": name, "value": value, "standard_error": float(error), "unit": known[name.partition("[")[0]].unit}
            for (name, value), error in zip(nominal.items(), errors, strict=True)
            if name not in self.given
        ]


def numbers(stage: Stage) -> dict[str, float]:
    """List the numbers of a stage of one axis that scatter."""
    found: dict[str, float] = {}
    for name, declaration in stage.declarations().items():
        value = getattr(stage, name)
        if declaration.scatter is Scattering.NONE:
            continue
        if isinstance(value, tuple):
            found.update({f"{name}[{i}]": float(item) for i, item in enumerate(value)})
        else:
            found[name] = float(value)
    return found


def assemble(datasets: Sequence[Dataset], family: str, method: str, axes: Sequence[AxisFit]) -> Fit:
    """Assemble model and report."""
    first = datasets[0]
    stages: list[Stage] = [merged([axis.stage for axis in axes])]
    if any(axis.problem.linear.sign < 0 for axis in axes):
        stages.append(Gain([axis.problem.linear.sign for axis in axes]))
    if any(axis.offset for axis in axes):
        stages.append(Offset([axis.offset for axis in axes]))
    parameters: list[ParameterRow] = [
        {**row, "axis": name} for axis, name in zip(axes, first.axes, strict=True) for row in axis.rows()
    ]
    return assembled(
        datasets,
        chain_model(datasets, stages, family),
        uncertainty(axes, first.axes),
        parameters,
        [],
        family=family,
        method=method,
        held_out=[axis.held_out for axis in axes],
    )


def uncertainty(axes: Sequence[AxisFit], names: Sequence[str]) -> Uncertainty:
    """Carry the covariances of the fits over to the numbers of the oscillators."""

    def stages_of(vectors: Sequence[Array]) -> Sequence[Stage]:
        return [merged([axis.problem.stage(axis.law, vector) for axis, vector in zip(axes, vectors, strict=True)])]

    return independent_axes([(axis.solution.parameters, axis.solution.covariance) for axis in axes], stages_of, names)


def merged(stages: Sequence[HystereticOscillator]) -> HystereticOscillator:
    """Merge the oscillators of several axes."""
    if len(stages) == 1:
        return stages[0]
    return replace(stages[0], **{field.name: [getattr(stage, field.name) for stage in stages] for field in fields(stages[0])})
