# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Uncertainty of the change that an effect makes, beside a model error that is carried over from a baseline record.

An error that is carried over holds for the plant as it was. An effect before the mechanics moves the model's output by Δ, and a model
that leaves a share of its output at a frequency is wrong by that share of Δ too:

    power of the uncertainty(f) = |error(f)|² / |output(f)|² · |Δ(f)|²,    at most |Δ(f)|²

What acts on the plant's whole output, error included, is carried exactly.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.diagnose.model_error.other_commands import lowest_frequency, simulated_rows
from hyst_control.diagnose.problem.problem import Problem
from hyst_control.identify.model_error.error_spectrum import ErrorSpectrum
from hyst_control.records.session_zero import without_zero


def relative_error(problem: Problem, series: Sequence[Annotated[Array, "N A"]]) -> ErrorSpectrum:
    """Carried errors beside the model's output, by frequency, as a share of power: 1 where the command does not drive the model."""
    errors = _spectrum(problem, [piece.counted(rows) for piece, rows in zip(problem.pieces, series, strict=True)])
    outputs = _spectrum(problem, [piece.counted(simulated_rows(problem, i, piece)) for i, piece in enumerate(problem.pieces)])
    share = (errors.power + errors.noise**2) / np.maximum(outputs.power, 1e-300)
    return replace(errors, power=np.minimum(share, 1.0))


def with_uncertain_change(problem: Problem, relative: ErrorSpectrum, change: Annotated[Array, "M A"]) -> Problem:
    """The problem with the uncertainty of a change of its model's output in its model discrepancy."""
    moved = _spectrum(problem, np.split(change, problem.edges))
    uncertain = ErrorSpectrum(moved.frequencies, moved.power * relative.power, relative.noise)
    known = problem.own_spectrum
    return replace(problem, own_spectrum=known.with_further(uncertain) if isinstance(known, ErrorSpectrum) else uncertain)


def _spectrum(problem: Problem, rows: Sequence[Array]) -> ErrorSpectrum:
    steady = [without_zero(one)[0] for one in rows]
    return ErrorSpectrum.of(steady, problem.sample_time, max(problem.counts), lowest_frequency(problem))
