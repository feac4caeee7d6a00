# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Model discrepancy on commands that no baseline record has: its spectrum, and its predictable part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.diagnose.configuration import BaselineSettings
from hyst_control.diagnose.problem.per_record_stages import ErrorBasis, LearnedError
from hyst_control.diagnose.problem.problem import Piece, Problem
from hyst_control.identify.data.excited_band import lowest_frequency as frequency_of
from hyst_control.identify.model_error.error_spectrum import ErrorSpectrum
from hyst_control.identify.model_error.learned_discrepancy import LearnedDiscrepancy
from hyst_control.records.session_zero import without_zero

MIN_DIRECTION = 0.1
"""Least rms of a direction of the learned error, in the rms of what it leaves, that is free in a diagnosis."""
UNEXCITED = 1e-6  # Power of a command, as a share of its largest, below which it excites nothing


def own_error_spectrum(errors: Sequence[Array], everything: Sequence[Array], clean: Problem, count: int) -> ErrorSpectrum:
    """Estimate the spectrum of the model discrepancy for a record of other length."""
    slowest = lowest_frequency(clean)

    def spectrum_of(series: Sequence[Array]) -> ErrorSpectrum:
        return ErrorSpectrum.of([without_zero(rows)[0] for rows in series], clean.sample_time, count, slowest)

    def driven_by(series: Sequence[Array]) -> Array:
        return spectrum_of([piece.command[-len(rows) :] for rows, piece in zip(series, clean.pieces, strict=True)]).power

    if all(len(some) == len(rows) for some, rows in zip(errors, everything, strict=True)):
        return spectrum_of(errors)
    driven, all_driven = driven_by(errors), driven_by(everything)
    least = UNEXCITED * np.max(all_driven, axis=0)
    return spectrum_of(everything).with_slow_part(spectrum_of(errors), (all_driven + least) / (driven + least))


def on_new_ground(
    spectrum: ErrorSpectrum, problem: Problem, clean: Problem, error: Annotated[Array, "A"], settings: BaselineSettings
) -> ErrorSpectrum:
    """Add to a model discrepancy's spectrum what the model may leave at frequencies that the new records' commands drive more."""
    count, slowest = len(spectrum.frequencies), lowest_frequency(clean)
    new = [without_zero(simulated_rows(problem, i, piece))[0] for i, piece in enumerate(problem.pieces)]
    known = [without_zero(simulated_rows(clean, i, piece))[0] for i, piece in enumerate(clean.pieces)]
    size, known_size = (np.sqrt(np.mean(np.concatenate(series) ** 2, axis=0)) for series in (new, known))
    if not (size.all() and known_size.all()):
        return spectrum  # without a model nothing is known of its output
    stated = np.asarray(problem.model.discrepancy.get("rms", 0.0), dtype=float)
    relative = settings.unseen * np.maximum(error / known_size, stated / size)
    before, now = (ErrorSpectrum.of(series, clean.sample_time, count, slowest) for series in (known, new))
    return spectrum.for_output(before, now, relative)


def learned_mean(learned: LearnedDiscrepancy, piece: Piece, rows: int, sample_time: float) -> Annotated[Array, "N 1"]:
    """The last rows of what a learned error predicts on a record."""
    features = learned.features.rows(np.ascontiguousarray(piece.command[:, 0]), sample_time)
    return np.asarray((features @ learned.mean)[-rows:, None], dtype=np.float64)


def predicted_error(problem: Problem, learned: LearnedDiscrepancy) -> tuple[LearnedError, ...]:
    """Predict a learned error on the records of a problem of one axis, in the fewest directions that matter.

    The mean is one direction more, free between absent and twice itself: on other commands it is a guess, and the nominal model stays
    the model as given.
    """
    rows = [
        without_zero(learned.features.rows(np.ascontiguousarray(piece.command[:, 0]), problem.sample_time))[0]
        for piece in problem.pieces
    ]
    factor = np.column_stack([learned.mean, learned.factor])
    spread = np.concatenate(rows) @ factor
    _, sizes, directions = np.linalg.svd(spread, full_matrices=False)
    kept = directions[sizes > MIN_DIRECTION * learned.rest * np.sqrt(len(spread))].T
    if not kept.shape[1]:
        return ()
    return (LearnedError(np.zeros(kept.shape[1]), ErrorBasis(tuple(design @ factor @ kept for design in rows))),)


def simulated_rows(problem: Problem, index: int, piece: Piece) -> Annotated[Array, "N A"]:
    """Simulate all rows of a record, also those that do not count."""
    alone = replace(problem, pieces=(replace(piece, keep=None),), sigma=np.ones(len(problem.sigma)))
    return alone.rows(alone.simulate([stage.for_record(index) for stage in problem.model.chain.stages]))


def lowest_frequency(problem: Problem) -> float:
    """Lowest frequency that the commands excite."""
    return frequency_of([piece.command for piece in problem.pieces], problem.sample_time)
