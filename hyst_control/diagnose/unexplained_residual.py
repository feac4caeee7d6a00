"""Residual of an explanation, without what its own effects leave by nature.

A converter's rounding error follows the signal and is no white noise; a vibration that wanders has skirts that no few polynomials
take off. Neither is a sign of something unknown.
"""

from __future__ import annotations

import numpy as np

from hyst_control.chain.parameter import Array
from hyst_control.diagnose.hypothesis_search import Scored
from hyst_control.diagnose.problem import Problem


def leftover(problem: Problem, scored: Scored, lattice: Array) -> Array:
    """The residual (M,) of an explanation, in units of the noise, without what its effects leave. lattice (A,): steps, 0 without."""
    rows = scored.solution.residual.reshape(-1, len(problem.model.axes))
    if scored.candidate is not None:
        for member, where in zip(scored.candidate.members, scored.candidate.slices(), strict=True):
            if member.is_line and member.line.skirt:
                frequency = member.values(scored.solution.x[where])["frequency"]
                rows = _without_band(problem, rows, 0 if member.axis is None else member.axis, frequency, member.line.skirt)
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
