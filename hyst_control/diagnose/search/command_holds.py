# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Candidates for a converter that holds the command: number of samples N and phase p of the hold, estimated from the gap.

A hold that samples the rows p, p + N, … delays the command u by m = (t - p) mod N rows at row t. It changes the measurement by

    g * (u(t - m) - u(t)) = g * (v(t) - u(t)) + g * (u(t - m) - v(t)),     v: moving average of u over N rows

where g is the impulse response of the model. The first part does not depend on p; a delay or a low-pass explains it as well. The second
part, the ripple, is specific to a hold. For a smooth command it is -g * u' (m - (N - 1) / 2). Its correlation with the gap for all p
follows from one sum: filter the gap by g in reversed time, multiply it by u', add the rows of equal t mod N, and correlate with a ramp.

Two estimates of N are kept: the one whose moving average reduces the gap most, and those with the largest correlation of the ripple.
For each N the phases with the largest correlation are kept, after the part of the moving average is subtracted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.signals import correlated
from hyst_control.diagnose.problem.problem import Piece, Problem
from hyst_control.diagnose.record_checks.command_roughness import with_commands
from hyst_control.diagnose.search.fit import Linearized

MAX_LENGTH = 128  # Samples: maximum length of a hold
COARSE = (2, 4, 8, 16, 32, 64, 128)  # Samples: lengths with which the search begins
LEADING = 3  # Lengths that are kept by their ripple, and phases of each length above `SHORT`
SHORT = 8  # Samples: maximum length of which all phases are kept, since its ripple is small
PUSH = 1e-4  # Impulse of the command, as a share of its range
RESPONSE_ROWS = 4096  # Rows: maximum length of the impulse response

Hold = tuple[int, int]  # Number of samples, and phase


def command_holds(linearized: Linearized) -> list[Hold]:
    """Find the most likely holds of each axis from the gap of the nominal model."""
    problem, left = linearized.problem, linearized.measured - linearized.nominal
    found: dict[Hold, None] = {}
    for axis in range(len(problem.model.axes)):
        if (response := impulse_response(problem, axis)) is None:
            continue
        commands = [piece.command[:, axis] for piece in problem.pieces]
        seen = _adjoint_residual(linearized, left, axis, response)
        nearest = _lengths_by_average(linearized, left, axis)
        for samples in dict.fromkeys((*nearest, *_lengths_by_ripple(commands, seen, response))):
            means = [_moving_average(command, samples) for command in commands]
            beside = _adjoint_residual(linearized, left - _output_change(problem, axis, means), axis, response)
            found.update(((samples, first), None) for first in _phases(commands, means, beside, samples))
    return list(found)


def _adjoint_residual(linearized: Linearized, left: Array, axis: int, response: Array) -> list[Array]:
    """Remove from a residual what the coefficients explain, and filter each record by the impulse response in reversed time."""
    problem, found = linearized.problem, list[Array]()
    parts = np.split(problem.rows(linearized.unexplained(left))[:, axis], problem.edges)
    for piece, part in zip(problem.pieces, parts, strict=True):
        rows = np.zeros(len(piece.command))
        rows[piece.mask] = part - part.mean()
        found.append(correlated(rows, response)[len(response) - 1 :])
    return found


def _output_change(problem: Problem, axis: int, commands: Sequence[Array]) -> Annotated[Array, "M"]:
    """Simulate other commands of an axis and subtract the simulation of the recorded ones; a flat vector of the problem."""
    stages = problem.model.chain.stages
    return with_commands(problem, axis, commands).simulate(stages) - problem.simulate(stages)


def _moving_average(command: Array, samples: int) -> Array:
    """Average each row with the rows before it; the first command precedes the record."""
    total = np.cumsum(np.concatenate([np.full(samples, command[0]), command]))
    return np.asarray((total[samples:] - total[:-samples]) / samples, dtype=np.float64)


def impulse_response(problem: Problem, axis: int) -> Annotated[Array, "K"] | None:
    """Impulse response of the model from the command to the output of an axis, at the middle of the record; None without a response."""
    longest = max(problem.pieces, key=lambda piece: len(piece.command))
    command = longest.command
    begin, span = len(command) // 2, float(np.ptp(command[:, axis]))
    if not problem.model.chain.stages or not span > 0.0:
        return None
    pushed = command[: begin + RESPONSE_ROWS].copy()
    plain, sigma = pushed.copy(), np.ones_like(problem.sigma)
    pushed[begin, axis] += PUSH * span
    simulated = [
        bare.rows(bare.simulate(bare.model.chain.stages))
        for rows in (pushed, plain)
        for bare in (replace(problem, pieces=(Piece(rows, rows, foreseen=True),), own_spectrum=None, sigma=sigma),)
    ]
    response = np.asarray((simulated[0] - simulated[1])[begin:, axis] / (PUSH * span), dtype=np.float64)
    return response if np.isfinite(response).all() and response.any() else None


def _lengths_by_average(linearized: Linearized, left: Array, axis: int) -> list[int]:
    """Find the length whose moving average reduces the gap most; return it and the lengths next to it."""
    problem = linearized.problem
    commands = [piece.command[:, axis] for piece in problem.pieces]

    @cache
    def reduction(samples: int) -> float:
        change = _output_change(problem, axis, [_moving_average(command, samples) for command in commands])
        return float((2.0 * left - change) @ linearized.unexplained(change))

    best = max((length for length in COARSE if length <= _max_length(commands)), key=reduction)
    step = best // 2
    while step:
        best = max((n for n in (best, best - step, best + step) if 2 <= n <= _max_length(commands)), key=reduction)
        step //= 2
    around = 1 + best // 32  # the estimate of a long hold is less precise
    return [n for n in range(best - around, best + around + 1) if n >= 2]


def _lengths_by_ripple(commands: Sequence[Array], seen: Sequence[Array], response: Array) -> list[int]:
    """Find the lengths whose ripple correlates most with the gap."""
    changes = [np.diff(command, prepend=command[0]) for command in commands]
    products = [-one * change for one, change in zip(seen, changes, strict=True)]
    driven = sum(float(change @ change) for change in changes)
    explained = {}
    for samples in range(2, _max_length(commands) + 1):
        added = np.sum([_folded(product, samples) for product in products], axis=0)
        ramp = np.fft.fft(np.arange(samples) - 0.5 * (samples - 1))
        along = float(np.max(np.fft.ifft(np.fft.fft(added) * np.conj(ramp)).real))
        gains = np.abs(np.fft.fft(_folded(response, samples))[1:]) ** 2
        energy = driven * float(np.sum(np.abs(ramp[1:] / samples) ** 2 * gains))
        explained[samples] = along**2 / energy if along > 0.0 < energy else 0.0
    return sorted(explained, key=lambda samples: -explained[samples])[:LEADING]


def _max_length(commands: Sequence[Array]) -> int:
    """Maximum length of a hold that is searched."""
    return min(MAX_LENGTH, min(map(len, commands)) // 4)


def _phases(commands: Sequence[Array], means: Sequence[Array], seen: Sequence[Array], samples: int) -> list[int]:
    """Find the phases whose ripple correlates most with the gap."""
    along = np.zeros((samples, samples))  # By delay of the hold, and by row modulo its length
    for command, mean, one in zip(commands, means, seen, strict=True):
        for behind in range(samples):
            ripple = command[: len(command) - behind] - mean[behind:]
            along[behind] += _folded(one[behind:] * ripple, samples, behind)
    at = np.arange(samples)
    correlation = [float(np.sum(along[(at - first) % samples, at])) for first in range(samples)]
    return [int(first) for first in np.argsort(correlation)[::-1][: samples if samples <= SHORT else LEADING]]


def _folded(values: Array, samples: int, begin: int = 0) -> Array:
    """Add the values of equal row modulo `samples`; the first value belongs to row `begin`."""
    padded = np.concatenate([np.zeros(begin), values, np.zeros(-(begin + len(values)) % samples)])
    return np.asarray(padded.reshape(-1, samples).sum(axis=0), dtype=np.float64)
