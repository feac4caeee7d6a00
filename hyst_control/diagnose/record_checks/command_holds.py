# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Holds of the command that a residual speaks for: over how many samples N a converter may hold it, and from which one on.

A hold that takes the samples p, p + N, … is behind the command u by m = (t - p) mod N samples at t. It changes the measurement by

    g * (u(t - m) - u(t)) = g * (v(t) - u(t)) + g * (u(t - m) - v(t)),     v(t): mean of u(t), …, u(t - N + 1)

where g is the response of the model to an impulse of the command. The mean is the same for all p, and other effects may explain it, a
delay or a low-pass. The ripple about it nothing else explains. Of a smooth command it is -u' (m - (N - 1) / 2): so the residual, filtered
by g with time reversed, and times u', is added up by t mod N, and that along a ramp is its correlation with the ripple, at every p at once.
The length whose mean takes off most is kept with its neighbors, and those that lead by a ripple of any size; then the p whose ripple
leads in what the mean leaves.
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

LONGEST = 128  # Samples over which a command may be held
COARSE = (2, 4, 8, 16, 32, 64, 128)  # Lengths from which the best one is looked for
LEADING = 3  # Lengths that are kept by their ripple, and first samples of each length that is not short
SHORT = 8  # Samples up to which every first sample is kept: the ripple of a short hold is small
PUSH = 1e-4  # Impulse of the command, as a share of its range
RESPONSE_ROWS = 4096  # Rows for which the response to it is followed

Held = tuple[int, int]  # Number of samples, and the first one that is taken


def command_holds(linearized: Linearized) -> list[Held]:
    """Holds that what the nominal model leaves speaks for: of every axis those that lead."""
    problem, left = linearized.problem, linearized.measured - linearized.nominal
    found: dict[Held, None] = {}
    for axis in range(len(problem.model.axes)):
        if (response := impulse_response(problem, axis)) is None:
            continue
        commands = [piece.command[:, axis] for piece in problem.pieces]
        seen = _seen(linearized, left, axis, response)
        nearest = _nearest(linearized, left, axis)
        for samples in dict.fromkeys((*nearest, *_rippled(commands, seen, response))):
            means = [_mean(command, samples) for command in commands]
            beside = _seen(linearized, left - _changed_by(problem, axis, means), axis, response)
            found.update(((samples, first), None) for first in _firsts(commands, means, beside, samples))
    return list(found)


def _seen(linearized: Linearized, left: Array, axis: int, response: Array) -> list[Array]:
    """What the coefficients cannot explain of a residual, through the response with time reversed, of every piece."""
    problem, found = linearized.problem, list[Array]()
    parts = np.split(problem.rows(linearized.unexplained(left))[:, axis], problem.edges)
    for piece, part in zip(problem.pieces, parts, strict=True):
        rows = np.zeros(len(piece.command))
        rows[piece.mask] = part - part.mean()
        found.append(correlated(rows, response)[len(response) - 1 :])
    return found


def _changed_by(problem: Problem, axis: int, commands: Sequence[Array]) -> Annotated[Array, "M"]:
    """What other commands of an axis change in the simulation, as the problem has it."""
    stages = problem.model.chain.stages
    return with_commands(problem, axis, commands).simulate(stages) - problem.simulate(stages)


def _mean(command: Array, samples: int) -> Array:
    """Mean of each command and those before it, so many together."""
    total = np.cumsum(np.concatenate([np.full(samples, command[0]), command]))
    return np.asarray((total[samples:] - total[:-samples]) / samples, dtype=np.float64)


def impulse_response(problem: Problem, axis: int) -> Annotated[Array, "K"] | None:
    """Response of the model's output on an axis to an impulse of its command, per unit of it, amid the record; None where it has none."""
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


def _nearest(linearized: Linearized, left: Array, axis: int) -> list[int]:
    """The number of samples whose mean takes off most, and its neighbors."""
    problem = linearized.problem
    commands = [piece.command[:, axis] for piece in problem.pieces]

    @cache
    def taken_off(samples: int) -> float:
        change = _changed_by(problem, axis, [_mean(command, samples) for command in commands])
        return float((2.0 * left - change) @ linearized.unexplained(change))

    best = max((length for length in COARSE if length <= _longest(commands)), key=taken_off)
    step = best // 2
    while step:
        best = max((n for n in (best, best - step, best + step) if 2 <= n <= _longest(commands)), key=taken_off)
        step //= 2
    around = 1 + best // 32  # a long one is known less well
    return [n for n in range(best - around, best + around + 1) if n >= 2]


def _rippled(commands: Sequence[Array], seen: Sequence[Array], response: Array) -> list[int]:
    """Numbers of samples whose ripple explains most, in any size."""
    changes = [np.diff(command, prepend=command[0]) for command in commands]
    products = [-one * change for one, change in zip(seen, changes, strict=True)]
    driven = sum(float(change @ change) for change in changes)
    explained = {}
    for samples in range(2, _longest(commands) + 1):
        added = np.sum([_added_up(product, samples) for product in products], axis=0)
        ramp = np.fft.fft(np.arange(samples) - 0.5 * (samples - 1))
        along = float(np.max(np.fft.ifft(np.fft.fft(added) * np.conj(ramp)).real))
        gains = np.abs(np.fft.fft(_added_up(response, samples))[1:]) ** 2
        energy = driven * float(np.sum(np.abs(ramp[1:] / samples) ** 2 * gains))
        explained[samples] = along**2 / energy if along > 0.0 < energy else 0.0
    return sorted(explained, key=lambda samples: -explained[samples])[:LEADING]


def _longest(commands: Sequence[Array]) -> int:
    """The largest number of samples that is looked at."""
    return min(LONGEST, min(map(len, commands)) // 4)


def _firsts(commands: Sequence[Array], means: Sequence[Array], seen: Sequence[Array], samples: int) -> list[int]:
    """The first samples of a hold whose ripple about the mean leads."""
    along = np.zeros((samples, samples))  # By how far the hold is behind, and by time
    for command, mean, one in zip(commands, means, seen, strict=True):
        for behind in range(samples):
            ripple = command[: len(command) - behind] - mean[behind:]
            along[behind] += _added_up(one[behind:] * ripple, samples, behind)
    at = np.arange(samples)
    correlation = [float(np.sum(along[(at - first) % samples, at])) for first in range(samples)]
    return [int(first) for first in np.argsort(correlation)[::-1][: samples if samples <= SHORT else LEADING]]


def _added_up(values: Array, samples: int, begin: int = 0) -> Array:
    """Sums (samples,) of values by their row modulo `samples`; the first one is of the row `begin`."""
    padded = np.concatenate([np.zeros(begin), values, np.zeros(-(begin + len(values)) % samples)])
    return np.asarray(padded.reshape(-1, samples).sum(axis=0), dtype=np.float64)
