# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Modal models fitted to spectra: refinement, error, information and covariance."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
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
