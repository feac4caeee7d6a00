# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Residual of an explanation, without what its own effects leave by nature: rounding errors, and the sidebands of a line that wanders."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.diagnose.problem.problem import Problem
from hyst_control.diagnose.search.beam_search import FittedHypothesis


def leftover(problem: Problem, scored: FittedHypothesis, lattice: Annotated[Array, "A"]) -> Annotated[Array, "M"]:
    """Remove from an explanation's residual what its own effects leave by nature."""
    rows = scored.solution.residual.reshape(-1, len(problem.model.axes))
    if scored.candidate is not None:
        for member, where in zip(scored.candidate.members, scored.candidate.slices(), strict=True):
            if member.is_line and member.line.skirt:
                frequency = member.values(scored.solution.x[where])["frequency"]
                for harmonic in (*member.line.harmonics, *member.line.overtones):
                    rows = _without_band(
                        problem, rows, 0 if member.axis is None else member.axis, harmonic * frequency, member.line.skirt
                    )
    half = 0.5 * lattice / problem.sigma
    return (np.sign(rows) * np.maximum(np.abs(rows) - half, 0.0)).reshape(-1)


def _without_band(problem: Problem, rows: Array, axis: int, frequency: float, skirt: float) -> Array:
    rows, begin = rows.copy(), 0
    for piece in problem.pieces:
        count = len(piece.counted(piece.measurement))
        spectrum = np.fft.rfft(rows[begin : begin + count, axis])
        at = np.fft.rfftfreq(count, problem.sample_time)
        spectrum[np.abs(at - frequency) <= max(skirt * frequency, 2.0 * at[1])] = 0.0
        rows[begin : begin + count, axis] = np.fft.irfft(spectrum, count)
        begin += count
    return rows
