# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Modal models fitted to spectra: refinement, error, information and covariance; their stages and numbers."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.chain.linear.linear_stages import Delay, StateSpace
from hyst_control.chain.stage import Stage
from hyst_control.identify.assess.assembly import AxisFit
from hyst_control.identify.data.fit import Number
from hyst_control.identify.modal.modal_fit import Problem, refine
from hyst_control.identify.modal.modal_model import Layout, ModalModel, Spectra


@dataclass(frozen=True)
class Candidate:
    """A fitted model with its relative errors (rms error / rms measurement)."""

    model: ModalModel  # The model
    fitted: float  # Error on the data fitted
    held_out: float  # Error on held-out data, NaN without them
    normal: Annotated[Array, "P P"]  # Normal matrix JᵀJ (P, P)
    variance: float  # Variance of the residual per equation
    layout: Layout  # Places of the parameters in the vector (P,)
    seconds: float  # Time that the fit took, s

    def covariance(self) -> tuple[Array, Array]:
        """Covariance of the parameters that make the model, for a white residual; transients are estimated along.

        b counts as known, as c could be exchanged for it.
        """
        kinds = ("pole", "c", "D", "delay")
        index = np.concatenate([np.arange(self.normal.shape[0])[self.layout.slices[kind]] for kind in (*kinds, "t", "d")])
        own = sum(len(np.arange(self.normal.shape[0])[self.layout.slices[kind]]) for kind in kinds)
        part = self.normal[np.ix_(index, index)]
        scale = np.sqrt(np.maximum(np.diag(part), 1e-300))
        inverse = np.linalg.pinv(part / scale / scale[:, None], rcond=1e-12, hermitian=True) / scale / scale[:, None]
        return index[:own], self.variance * inverse[:own, :own]


def error_of(model: ModalModel, data: Sequence[Spectra]) -> float:
    """Relative error (rms error / rms measurement) of a model on spectra.

    Transients are fitted, as the state at the start of a cut is unknown; what they fit of the error by their number alone is added
    again, so that a large model on a short cut gains nothing by them.
    """
    problem = Problem(data, model)
    free = 0
    if problem.records:
        problem.fit_linear("t", "d")
        free = sum(int(np.count_nonzero(problem.free[problem.layout.slices[kind]])) for kind in ("t", "d"))
    count = equations(data)
    return float(np.sqrt(problem.cost() / problem.power * count / max(count - free, 1)))


def equations(data: Sequence[Spectra]) -> int:
    """Count the real equations that spectra make."""
    return sum(2 * spectra.measurement.size for spectra in data)


def refined(
    data: Sequence[Spectra], start: ModalModel, direct: bool, free_delay: bool, iterations: int, kind: type[Problem] = Problem
) -> Candidate:
    """Refine a model by its output error."""
    began = time.perf_counter()
    problem = kind(data, start, direct, free_delay)
    cost, matrix = refine(problem, iterations)
    variance = cost / max(equations(data) - problem.layout.size, 1)
    error = float(np.sqrt(cost / problem.power))
    return Candidate(problem.model, error, np.nan, matrix, variance, problem.layout, time.perf_counter() - began)


def information(candidate: Candidate, data: Sequence[Spectra]) -> float:
    """Schwarz's information criterion up to a constant: lower is better."""
    count = equations(data)
    return 2 * count * float(np.log(candidate.fitted)) + candidate.model.parameters * float(np.log(count))


def axis_fit(found: Candidate, sample_time: float) -> AxisFit:
    """The fit of all axes; its parameters are changes of those of the model."""
    index, spread = found.covariance()

    def model(vector: Array) -> ModalModel:
        change = np.zeros(found.layout.size)
        change[index] = vector
        return found.model.moved(change, found.layout)

    largest = max(float(np.abs(found.model.outputs).max(initial=0.0)), 1e-300)
    return AxisFit(
        lambda vector: stages_of(model(vector), sample_time),
        np.zeros(len(index)),
        spread,
        lambda vector: _numbers(model(vector), sample_time),
        sizes=np.where(np.isin(index, found.layout.indices("c", -1)), largest, 1.0),
    )


def _numbers(model: ModalModel, sample_time: float) -> list[Number]:
    """Frequency and damping of every pole, and the delays."""
    found = []
    for i, pole in enumerate(model.poles):
        found.append(Number(f"frequency[{i}]", abs(pole) / (2 * np.pi * sample_time), "Hz"))
        if pole.imag:
            found.append(Number(f"damping[{i}]", -pole.real / abs(pole)))
    return found + [Number(f"delay[{j}]", late * sample_time, "s") for j, late in enumerate(model.delay) if late > 0]


def stages_of(model: ModalModel, sample_time: float) -> list[Stage]:
    """Convert a model into stages: the delay if there is one, then a `state_space`."""
    stages: list[Stage] = [Delay(scalar_if_alike(model.delay * sample_time))] if np.any(model.delay > 0) else []
    a, b, c, d = model.state_space()
    return [*stages, StateSpace(a / sample_time, b / sample_time, c, d)]


def scalar_if_alike(values: Array) -> float | list[float]:
    """One number where all `values` are the same, else all of them."""
    return float(values[0]) if np.all(values == values[0]) else [float(value) for value in values]
