# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Discrepancy on a new record given baseline records of the same command: one conditional Gaussian, frequency by frequency.

    new record y = d + e,   baseline records c_i = d + e_i (i = 1 … n),   d ~ N(0, S), e ~ N(0, R)

    E[d | c] = S / (S + R/n) · mean(c),     Var[y | c] = R + S · (R/n) / (S + R/n)

Where S ≫ R the mean of the baseline records is subtracted, at a variance of R (1 + 1/n). Without baseline records the variance is R + S.
S is the power density of what repeats with the command, R that of the noise and of the machine's variation from run to run.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.fft import dct, idct

from hyst_control.base.arrays import Array
from hyst_control.diagnose.configuration import BaselineSettings
from hyst_control.diagnose.model_error.baseline import Baseline
from hyst_control.diagnose.problem.per_record_stages import CarriedError
from hyst_control.diagnose.problem.problem import Piece
from hyst_control.identify.model_error.error_spectrum import ErrorSpectrum
from hyst_control.records.session_zero import without_zero


def conditional(mean: Array, repeating: Array, varying: Array, count: int) -> tuple[Array, Array]:
    """Mean of the discrepancy, and variance of a new record about it, given the mean of `count` baseline records."""
    if count < 1:
        return np.zeros_like(mean), repeating + varying
    kept = repeating / np.maximum(repeating + varying / count, 1e-300)
    return kept * mean, varying + (1.0 - kept) * repeating


def conditioned(baseline: Baseline, settings: BaselineSettings) -> Baseline:
    """The baseline of the same command with the conditional mean as its carried error, and the spectrum of what that leaves open."""
    problem = baseline.problem
    stages = problem.model.chain.stages
    place = next((i for i, stage in enumerate(stages) if isinstance(stage, CarriedError)), None)
    if place is None or baseline.clean is None:
        return baseline
    carried = stages[place]
    assert isinstance(carried, CarriedError)
    count = max(len(baseline.clean.pieces) // len(problem.pieces), 1)
    longest = max(problem.counts)
    slowest = problem.surroundings.lowest_frequency

    def spectrum(series: list[Array]) -> Array:
        return ErrorSpectrum.of(series, problem.sample_time, longest, slowest).power

    repeating = spectrum([without_zero(piece.counted(rows))[0] for piece, rows in zip(problem.pieces, carried.series, strict=True)])
    if isinstance(problem.own_spectrum, ErrorSpectrum):
        between = problem.own_spectrum.power / (1.0 + 1.0 / count)
    else:  # a single record of a command without periods: only a usual share of the motion is known
        between = settings.usual_repeatability**2 * spectrum([_motion(piece) for piece in problem.pieces])
    varying = between + problem.sigma**2
    frequencies = 0.5 / problem.sample_time * np.arange(longest) / longest
    series = []
    for rows in carried.series:
        rest, _ = without_zero(rows)
        at = 0.5 / problem.sample_time * np.arange(len(rows)) / len(rows)
        kept, new = (np.stack([np.interp(at, frequencies, column) for column in power.T], axis=1) for power in (repeating, varying))
        mean, _ = conditional(dct(rest, norm="ortho", axis=0), kept, new, count)
        series.append(np.asarray(rows - rest + idct(mean, norm="ortho", axis=0), dtype=np.float64))
    _, variance = conditional(np.zeros_like(repeating), repeating, varying, count)
    own = ErrorSpectrum(frequencies, np.maximum(variance - problem.sigma**2, 0.0), np.zeros(len(problem.sigma)))
    model = problem.model.with_stages((*stages[:place], CarriedError(tuple(series), carried.index), *stages[place + 1 :]))
    return replace(baseline, problem=replace(problem, model=model, own_spectrum=own))


def _motion(piece: Piece) -> Array:
    """Measured rows that count, without zero and drift."""
    return without_zero(piece.counted(piece.measurement))[0]
