# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Differences between periods of a command, beside a model discrepancy of which the size alone is known: it returns with every period."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hyst_control.chain.command_features import CommandFeatures
from hyst_control.diagnose.model_error.baseline import Baseline
from hyst_control.diagnose.model_error.other_commands import MIN_DIRECTION
from hyst_control.diagnose.problem.per_record_stages import ErrorBasis, LearnedError
from hyst_control.diagnose.problem.periodic_error import PeriodicError
from hyst_control.diagnose.problem.problem import Piece, Problem
from hyst_control.diagnose.search.fit import Linearized, Solution
from hyst_control.records.repeated_periods import period_of

MIN_PERIODS = 3
"""Whole periods beside which a discrepancy comes back: the first one still fills the memory, and two are compared."""
COURSE = 3  # Degree of the polynomial of time that stands for the course of a gain


def by_periods(baseline: Baseline, problem: Problem) -> Baseline | None:
    """The baseline of a problem with a discrepancy that comes back with every period; None where no command is periodic."""
    if problem.own_error is None or problem.own_energy == 0.0 or len(problem.model.axes) > 1:
        return None
    # Where the command comes back nearly, the discrepancy differs by less than the rows tell beside the noise.
    same = float(problem.sigma[0] / problem.own_error[0] / np.sqrt(sum(problem.counts)))
    periods = tuple(_period(piece, same) for piece in problem.pieces)
    if not any(periods):
        return None
    error = PeriodicError(periods, problem.weight, problem.own_error)
    basis = _settling(problem, error)
    *stages, zero = problem.model.chain.stages
    settling = LearnedError(np.zeros(basis.directions[0].shape[1]), basis)
    beside = replace(problem, model=problem.model.with_stages((*stages, settling, zero)), own_spectrum=error)
    return replace(baseline, problem=beside, floor=np.zeros_like(baseline.floor))


def gain_over_time(baseline: Baseline, linearized: Linearized, none: Solution) -> float:
    """Nats by which a gain that changes over the record is better than "no effect", beside the model's coefficients and what settles.

    A closed form: a linear regression on the model's output times powers of time, of the record without this discrepancy (`linearized`).
    """
    problem = baseline.problem
    error, settling = problem.own_spectrum, problem.model.chain.stages[-2]
    assert isinstance(error, PeriodicError) and isinstance(settling, LearnedError) and settling.basis is not None
    simulated, left, columns = (
        np.split(values, problem.edges)
        for values in (linearized.measured - none.residual, none.residual + linearized.columns @ none.z, linearized.columns)
    )
    parts = []
    for index, (piece, directions) in enumerate(zip(problem.pieces, settling.basis.directions, strict=True)):
        times = np.linspace(-1.0, 1.0, len(simulated[index]))
        swing = simulated[index] - np.mean(simulated[index])  # beside the zero, which drifts too
        courses = swing[:, None] * np.polynomial.legendre.legvander(times, COURSE)[:, 1:]
        rows = [left[index], columns[index], piece.counted(directions) / problem.sigma, courses]
        parts.append(error.whitened(index, np.column_stack(rows)))
    found = np.concatenate(parts)
    products = found.T @ found
    known, course = slice(1, -COURSE), slice(-COURSE, None)
    inverse = np.linalg.inv(products[known, known] + np.eye(len(products) - 1 - COURSE))
    products -= products[:, known] @ inverse @ products[known]
    along = products[course, 0]
    return float(0.5 * along @ np.linalg.lstsq(products[course, course], along)[0])


def _settling(problem: Problem, error: PeriodicError) -> ErrorBasis:
    """Directions of what periods may differ by: features of the command that settle, each as large as the error at most."""
    size, found = float(error.own_error[0]), []
    features = CommandFeatures.of([piece.command[:, 0] for piece in problem.pieces], problem.sample_time)
    for index, piece in enumerate(problem.pieces):
        rows = features.rows(np.ascontiguousarray(piece.command[:, 0]), problem.sample_time)
        settling = np.zeros_like(rows)
        settling[piece.mask] = size / np.maximum(np.std(rows, axis=0), 1e-9) * error.between(index, piece.counted(rows))
        found.append(settling)
    _, sizes, directions = np.linalg.svd(np.concatenate(found), full_matrices=False)
    worth = np.count_nonzero(sizes > MIN_DIRECTION * problem.sigma[0] * np.sqrt(sum(map(len, found))))
    return ErrorBasis(tuple(rows @ directions[: max(worth, 1)].T for rows in found))


def _period(piece: Piece, same: float) -> int | None:
    """Rows of a period of a record whose rows that count are one stretch of `MIN_PERIODS` or more."""
    rows, command = piece.counted(np.arange(len(piece.command), dtype=np.float64)), piece.counted(piece.command)
    period = period_of(command, same) if rows[-1] - rows[0] < len(rows) else None
    return period if period is not None and len(command) >= MIN_PERIODS * period else None
