# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Structure of a gap that no known effect explains: even part, odd part, memory.

The gap is regressed on functions of the command and of the simulated motion, each as it is and through the model. A question is a group of
functions, its answer the reduction of the error on held-out blocks over that of a linear correction alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Annotated

import numpy as np
from scipy.special import ndtr

from hyst_control.base.arrays import Array, Integers
from hyst_control.base.errors import InputError
from hyst_control.chain.hysteresis.prandtl_ishlinskii import PlayOperator
from hyst_control.chain.stage import Sampling
from hyst_control.diagnose.problem.problem import Problem
from hyst_control.model_file import Model, simulate

MAX_ROWS = 2**15  # Rows from the beginning of a record that are used
BLOCKS = 10
RIDGES = (1e-4, 1e-2, 1.0)  # Of the regression, of which each group takes the best: short records bear few functions
LAGS = (0.0, 0.25, 0.5, 1.0, 2.0, 4.0)  # Multiples of the time in which the motion's autocorrelation falls to a half
HALF_WIDTHS = (0.1, 0.25, 0.5)  # Of the stop operators, as shares of the largest distance from the mean
MIN_SHARE = 0.02  # Share of the gap that a group must remove, beyond its scatter, to count as there
GROUPS = ("linear", "odd", "even", "odd memory", "even memory")


def gap_structure(problem: Problem, axes: Sequence[int]) -> dict[str, float]:
    """Probability that the gap on some axes has an even part, an odd part, and memory; empty where the record is too short."""
    # problem: as it was recorded, with the rows that repeat the one before: an end stop holds the measurement as well
    piece = max(problem.pieces, key=lambda each: len(each.command))
    rows = min(len(piece.command), MAX_ROWS)
    counted = np.flatnonzero(piece.mask[:rows])
    if len(counted) < 20 * BLOCKS:
        return {}
    command, measured = piece.command[:rows], piece.measurement[:rows]
    try:
        simulated = simulate(problem.model, command)
        found = []
        for axis in axes:
            columns = features(problem.model, command, simulated, axis)
            found.append(Regression((measured - simulated)[counted, axis], [each[counted] for each in columns]))
    except (InputError, np.linalg.LinAlgError):
        return {}
    return answers(found)


def answers(found: Iterable[Regression]) -> dict[str, float]:
    """Answers to all questions from the regressions of one or more axes."""
    regressions = list(found)

    def errors(*groups: str) -> Array:
        return np.asarray(np.sum([one.errors(groups) for one in regressions], axis=0))

    base = float(errors("linear").mean())

    def probability(without: Array, whole: Array) -> float:
        gain = (without - whole) / max(base, 1e-300)
        scatter = max(float(gain.std(ddof=1)) / np.sqrt(len(gain)), 1e-9)
        return float(ndtr((gain.mean() - MIN_SHARE) / scatter))

    whole = errors(*GROUPS)
    even = probability(errors("linear", "odd", "odd memory"), whole)
    odd = probability(errors("linear", "even", "even memory"), whole)
    # Functions of a parity that is not there would only hide the memory of the other one.
    there = [parity for parity, is_there in (("odd", odd), ("even", even)) if is_there > 0.5] or ["odd", "even"]
    memory = probability(errors("linear", *there), errors("linear", *there, *(f"{parity} memory" for parity in there)))
    return {"memory": memory, "even": even, "odd": odd}


class Regression:
    """Ridge regression of a gap (N,) on groups of columns (N, K), with errors on blocks that were held out."""

    def __init__(self, gap: Array, groups: list[Array]) -> None:
        edges = np.cumsum([0, *(group.shape[1] for group in groups)])
        self.columns = {name: np.arange(a, b) for name, a, b in zip(GROUPS, edges[:-1], edges[1:], strict=True)}
        x = np.concatenate(groups, axis=1)
        x = x - x.mean(axis=0)
        x = x / np.maximum(x.std(axis=0), 1e-300)
        y = gap - gap.mean()
        self.rows = len(y)
        parts = [np.column_stack([a, b]) for a, b in zip(np.array_split(x, BLOCKS), np.array_split(y, BLOCKS), strict=True)]
        self.grams = np.stack([part.T @ part for part in parts])
        self.lengths = np.array([len(part) for part in parts])

    def errors(self, groups: Iterable[str]) -> Annotated[Array, "B"]:
        """Mean square error of every block, fitted on the others."""
        used = np.concatenate([self.columns[name] for name in groups])
        tried = [self._held_out(used, ridge) for ridge in RIDGES]
        return min(tried, key=lambda errors: float(errors.mean()))

    def _held_out(self, used: Integers, ridge: float) -> Annotated[Array, "B"]:
        whole, found = self.grams.sum(axis=0), []
        square = np.ix_(used, used)
        for gram, length in zip(self.grams, self.lengths, strict=True):
            rest = whole - gram
            weights = np.linalg.solve(rest[square] + ridge * self.rows * np.eye(len(used)), rest[used, -1])
            found.append((gram[-1, -1] - 2.0 * weights @ gram[used, -1] + weights @ gram[square] @ weights) / length)
        return np.array(found)


def features(model: Model, command: Annotated[Array, "N A"], simulated: Annotated[Array, "N A"], axis: int) -> list[Array]:
    """Functions of one axis, a matrix (N, K) for each of `GROUPS`."""
    lags = _lags(simulated[:, axis])
    signals = [_within_one(values[:, axis]) for values in (command, simulated)]
    stops = [(x, x - _play(x, width)) for x in signals for width in HALF_WIDTHS]
    groups = (
        signals,
        [bent for x in signals for bent in (x**3, x * np.abs(x), np.tanh(4.0 * x))],
        [bent for x in signals for bent in (x**2, np.abs(x), x**4)],
        [stop for _, stop in stops],
        [bent for x, stop in stops for bent in (x * stop, np.abs(stop))],
    )
    drive, resting = np.std(command[:, axis]), np.broadcast_to(command.mean(axis=0), command.shape)
    still = simulate(model, resting)[:, axis]
    found = []
    for group in groups:
        columns = []
        for values in group:
            driven = resting.copy()
            driven[:, axis] += drive * (values - values.mean()) / max(float(values.std()), 1e-300)
            for way in (values - values.mean(), simulate(model, driven)[:, axis] - still):
                columns += [np.concatenate([np.zeros(lag), way[: len(way) - lag]]) for lag in lags]
        found.append(np.stack(columns, axis=1))
    return found


def _lags(motion: Annotated[Array, "N"]) -> list[int]:
    """Delays in samples, by the time in which the motion's autocorrelation falls to a half."""
    spectrum = np.fft.rfft(motion - motion.mean(), 2 * len(motion))
    correlation = np.fft.irfft(np.abs(spectrum) ** 2)[: len(motion)]
    half = max(int(np.argmax(correlation < 0.5 * correlation[0])), 1)
    return sorted({min(round(half * lag), len(motion) // 2) for lag in LAGS})


def _within_one(values: Annotated[Array, "N"]) -> Annotated[Array, "N"]:
    """Distance from the mean, in units of the largest."""
    distance = values - values.mean()
    return np.asarray(distance / max(float(np.abs(distance).max()), 1e-300))


def _play(values: Annotated[Array, "N"], half_width: float) -> Annotated[Array, "N"]:
    running = PlayOperator(half_width).filter(Sampling(1.0, 1))
    running.settle(values[:1])
    return running.process(values[:, None])[:, 0]
