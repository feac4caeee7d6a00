# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Roughness of a recorded command that the plant did not receive, as of a command that is rounded in the record only.

The recorded command c is smoothed to c_s without phase. What the model M makes of the roughness is d = M(c) - M(c_s). If the plant did
not receive it, the residual y - M(c) has -d in it, whatever the model is like: its regression on d is -1 at every frequency, and nothing
follows d later. A plant that did receive it has 0, one behind a low-pass 0 at low frequencies, one behind a delay an echo of d.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.diagnose.evidence import RoughnessEvidence
from hyst_control.diagnose.problem.problem import Piece, Problem
from hyst_control.diagnose.record_checks.command_smoothing import smoothed, white_part

BANDS = 4  # Bands of equal information in which the residual is regressed on d
MIN_ROWS = 64  # Rows that a record needs
MIN_SHARE = 1e-6
"""White part of a command, as a share of its rms, under which nothing is looked at: numbers of few digits."""


def roughness_evidence(problem: Problem, axis: int) -> tuple[RoughnessEvidence | None, tuple[Array, ...]]:
    """Measure the roughness of a command, and how much of it the plant received."""
    columns = [piece.command[:, axis] for piece in problem.pieces]
    if min(len(column) for column in columns) < MIN_ROWS or not problem.model.chain.stages:
        return None, ()
    white, whole = max(white_part(column) for column in columns), max(float(np.std(column)) for column in columns)
    if not white > MIN_SHARE * whole or white > whole:
        return None, ()
    smooth = tuple(smoothed(column) for column in columns)
    rough = [column - one for column, one in zip(columns, smooth, strict=True)]
    every = np.concatenate(rough)
    energy, size = float(np.mean(every**2)), np.abs(every)
    lagged = [sum(float(one[lag:] @ one[:-lag]) for one in rough) / len(every) / energy for lag in (1, 2, 3)]
    bare = replace(problem, own_spectrum=None)
    stages = bare.model.chain.stages
    nominal = bare.simulate(stages)
    response = bare.rows(nominal - with_commands(bare, axis, smooth).simulate(stages))
    residual = bare.rows(bare.measured() - nominal)
    moved = float(np.sqrt(np.mean(response**2)))
    if not (np.isfinite(moved) and moved > 0.0):
        return None, ()
    evidence = RoughnessEvidence(
        len(every),
        float(np.sqrt(energy)),
        energy / max(float(np.mean(np.concatenate([np.square(one - one.mean()) for one in smooth]))), 1e-300),
        max(abs(value) for value in lagged),
        float(np.quantile(size, 0.95) / max(float(np.median(size)), 1e-300)),
        *_regressed(bare, residual, response),
        float(np.sqrt(np.mean(response**2, axis=0))[axis]),
    )
    return evidence, smooth


def with_commands(problem: Problem, axis: int, smooth: Sequence[Array]) -> Problem:
    """Put a smooth command in the place of the recorded one, which every piece keeps beside it."""

    def changed(piece: Piece, column: Array) -> Piece:
        command = piece.command.copy()
        command[:, axis] = column
        return replace(piece, command=command, recorded=piece.command if piece.recorded is None else piece.recorded)

    return replace(problem, pieces=tuple(changed(piece, one) for piece, one in zip(problem.pieces, smooth, strict=True)))


def as_recorded(problem: Problem) -> Problem:
    """Take the commands as they were recorded."""
    if all(piece.recorded is None for piece in problem.pieces):
        return problem
    recorded = [
        piece if piece.recorded is None else replace(piece, command=piece.recorded, recorded=None) for piece in problem.pieces
    ]
    return replace(problem, pieces=tuple(recorded))


def _regressed(problem: Problem, residual: Array, response: Array) -> tuple[float, float, tuple[tuple[float, float], ...], float]:
    """Coefficient of the residual on the response with its deviation, the same by band, and the largest echo of the response."""
    longest = int(np.argmax(problem.counts))
    window = np.hanning(problem.counts[longest] - 1)[:, None]
    seen, driven = (
        np.fft.rfft(np.diff(np.split(one, problem.edges)[longest], axis=0) * window, axis=0)[1:] for one in (residual, response)
    )
    # Weighted by the spectrum of what would be left if the plant had not received the roughness.
    reach = max(len(seen) // 50, 2)
    kernel = np.ones(2 * reach + 1) / (2 * reach + 1)
    left = np.stack(
        [np.convolve(np.pad(one, reach, mode="reflect"), kernel, "valid") for one in np.abs((seen + driven).T) ** 2], axis=1
    )
    weight = 1.0 / np.maximum(left, 1e-12 * left.max() + 1e-300)
    information = np.sum(weight * np.abs(driven) ** 2, axis=1)
    gathered = np.cumsum(information) / information.sum()
    edges = np.searchsorted(gathered, np.arange(1, BANDS) / BANDS)
    edges = np.concatenate([[0], edges, [len(information)]])

    def regression(part: slice) -> tuple[float, float]:
        known = float(information[part].sum())
        if known <= 0.0:
            return 0.0, np.inf
        value = float(np.sum((weight * (seen * np.conj(driven)).real)[part])) / known
        rest = weight[part] * np.abs(seen[part] - value * driven[part]) ** 2
        count = max(rest.size, 1)
        # Neighboring bins of a Hann window are correlated, and each has a real and an imaginary part: half as many are independent.
        return value, float(np.sqrt(1.5 * np.sum(rest) / count / known))

    echoes = np.fft.irfft(np.concatenate([[0.0], np.sum(weight * (seen + driven) * np.conj(driven), axis=1)]), 2 * len(seen))
    echo = float(np.max(np.abs(echoes))) * len(seen) / float(information.sum())
    value, deviation = regression(slice(None))
    bands = tuple(regression(slice(int(a), int(b))) for a, b in zip(edges[:-1], edges[1:], strict=True))
    return value, deviation, bands, echo
