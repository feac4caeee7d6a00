# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Learning from trial to trial: the feedforward of a reference that repeats is improved by the error of the periods before.

A trial is `settling` periods, in which the loop forgets the feedforward before, and `averaged` periods that are measured. Then,
line by line of the period's spectrum,

    u <- u + share Q (e / G + u_b)

with the means of error and feedback over the measured periods (see `learning_filter`). `share` is `gain` at first. Where a line's
error falls by less than half, beyond its noise, the loop is not the one that the filter was made for, and two trials have measured it
better: from then on the line learns by the secant through them,

    u <- u + share (u_2 - u_1) / (e_1 - e_2) e

(Kim and Zou's modeling-free step). Where an error has grown, the line goes back to its best feedforward first, and halves
its share if it had been measured anew before. What differs between the measured periods is noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.control.learning.learning_filter import LearningFilter
from hyst_control.control.learning.learning_loop import ENDLESS, Learner

NOISE, GROWTH, GAIN, PATIENCE = 2.0, 1.1, 0.05, 3
"""Learning stops at `NOISE` times the noise that is left in the mean error, and when an error is `GROWTH` over the least one, or less than
`GAIN` below it, in `PATIENCE` trials in a row."""
MAX_ROWS = 20_000_000  # Samples of a trial, and of all trials together: their signals are kept
SIGNIFICANT = 4.0  # Standard deviations of its noise beyond which a line's error tells something
SLOW = 0.5  # Share of a line's error that a trial may leave before the line is measured anew


@dataclass(frozen=True)
class Trial:
    """One trial's error in the measurement unit, rms over the measured periods and all axes.

    error: all of it; repeating: of the mean over the periods; noise: what is left of the noise in that mean.
    """

    error: float
    repeating: float
    noise: float


@dataclass(frozen=True)
class IterativeLearning:
    """Description of the learner; `start` makes a running one."""

    filter: LearningFilter
    settling: int = 1  # Periods of a trial that are not measured, at least 1, and that are, at least 2
    averaged: int = 2
    gain: float = 1.0
    trials: int = 20
    limit: float = np.inf

    def __post_init__(self) -> None:
        for name, least in (("settling", 1), ("averaged", 2), ("trials", 1)):
            if getattr(self, name) < least:
                raise InputError(f"{name}: must be at least {least}, got {getattr(self, name)}")
        if self.trial_rows > MAX_ROWS:
            raise InputError(f"averaged: a trial of {self.trial_rows} samples is too long to keep: take fewer periods")
        if not 0.0 < self.gain <= 1.0:
            raise InputError(f"gain: must be above 0 and at most 1, got {self.gain:g}")
        if not self.limit > 0.0:
            raise InputError(f"limit: must be above 0 V, got {self.limit:g}")

    @property
    def trial_rows(self) -> int:
        """Samples of a trial."""
        return (self.settling + self.averaged) * self.filter.period

    def start(self, feedforward: Array | None = None) -> RunningIterativeLearning:
        """Start a learner from one period (N, A) of a learned `feedforward` in V, or from zero."""
        return RunningIterativeLearning(self, feedforward)


class RunningIterativeLearning(Learner):
    """The learner's state. `history` has the trials, `stopped` says why it learns no more ("" while it does)."""

    def __init__(self, description: IterativeLearning, feedforward: Array | None = None) -> None:
        self.description = description
        shape = (description.filter.period, description.filter.axes)
        self._first = np.zeros(shape) if feedforward is None else np.array(feedforward, dtype=float)
        if self._first.shape != shape:
            raise InputError(f"feedforward: must have the shape {shape} of a period, got {self._first.shape}")
        self.reset()

    def reset(self) -> None:
        about = self.description
        shape = (about.averaged, about.filter.period, about.filter.axes)
        self.history: list[Trial] = []
        self.stopped = ""
        self.feedforward = self._first
        """One period (N, A) of what is added, in V, from a tick that is a multiple of the period after the first one."""
        self._best = self.feedforward
        self._origin: int | None = None
        self._begin = self._end = 0  # tick at which the trial began, and up to which rows were given
        self._measured = 0  # rows of this trial
        self._error, self._feedback = np.zeros((2, *shape))
        lines = (shape[1] // 2 + 1, shape[2])
        self._share = np.full(lines, about.gain)
        self._secant = np.full(lines, np.nan, dtype=complex)  # V per measurement unit, of lines that were measured anew
        self._least: Array | None = None  # of each line the least error so far, its feedforward and the correction it asks for
        self._kept, self._correction = np.zeros((2, *lines), dtype=complex)

    def available(self, first: int) -> int:
        if self.stopped:
            return ENDLESS
        begin = first if self._origin is None else self._begin
        return max(begin + self.description.trial_rows - first, 0)

    def learned(self, first: int, feedforward: Array) -> Array:
        if self._origin is None:
            self._origin = self._begin = first
        self._end = first + len(feedforward)
        return np.asarray(self.feedforward[np.arange(first - self._origin, self._end - self._origin) % len(self.feedforward)])

    def observe(self, first: int, reference: Array, measurement: Array, feedback: Array) -> None:
        """Learn from the loop's signals of the ticks from `first` on; a gap in them begins the trial anew."""
        error = np.asarray(reference - measurement)
        while len(error) and not self.stopped and self._origin is not None:
            about = self.description
            window = self._begin + about.settling * about.filter.period
            expected = window + self._measured
            skipped = min(max(expected - first, 0), len(error))  # of the settling periods, or seen before
            first, error, feedback = first + skipped, error[skipped:], feedback[skipped:]
            if not len(error):
                return
            if first > expected:
                self._begin, self._measured = max(self._end, first), 0
                continue
            taken = min(len(error), about.averaged * about.filter.period - self._measured)
            rows = slice(self._measured, self._measured + taken)
            self._error.reshape(-1, error.shape[1])[rows] = error[:taken]
            self._feedback.reshape(-1, error.shape[1])[rows] = feedback[:taken]
            self._measured += taken
            first, error, feedback = first + taken, error[taken:], feedback[taken:]
            if self._measured == about.averaged * about.filter.period:
                self._conclude(window - self._origin)
                self._begin, self._measured = max(first, self._end), 0

    def _conclude(self, phase: int) -> None:
        """The trial is complete; phase: ticks from the origin to its first measured row."""
        about = self.description
        mean = self._error.mean(axis=0)
        noise = float(np.sqrt(self._error.var(axis=0, ddof=1).mean() / about.averaged))
        trial = Trial(float(np.sqrt(np.mean(self._error**2))), float(np.sqrt(np.mean(mean**2))), noise)
        before = [each.repeating for each in self.history]
        best = min(before, default=np.inf)
        self.history.append(trial)
        if trial.repeating <= best:
            self._best = self.feedforward
        recent = [*before[-PATIENCE + 1 :], trial.repeating]
        earlier = min(before[: len(before) - PATIENCE + 1], default=np.inf)
        if trial.repeating <= NOISE * noise:
            self.stopped = "the repeating error is below twice its noise"
        elif len(recent) == PATIENCE and min(recent) > GROWTH * earlier:
            self.stopped = "error grows"
        elif len(recent) == PATIENCE and min(recent) > (1.0 - GAIN) * earlier:
            self.stopped = "nothing gained"
        elif len(self.history) >= about.trials:
            self.stopped = "last trial"
        if self.stopped:
            self.feedforward = self._best
            return
        self.feedforward = self._improved(mean, phase % about.filter.period)

    def _improved(self, mean: Array, phase: int) -> Array:
        """The next feedforward (N, A) from the mean error (N, A), which begins `phase` ticks after a multiple of the period."""
        about = self.description
        each = np.fft.rfft(np.roll(self._error, phase, axis=1), axis=1)
        error, tried = each.mean(axis=0), np.fft.rfft(self.feedforward, axis=0)
        noise = np.sqrt(np.mean(np.abs(each - error) ** 2, axis=0) / (about.averaged - 1))
        correction = np.fft.rfft(np.roll(about.filter.correction(mean, self._feedback.mean(axis=0)), phase, axis=0), axis=0)
        better = np.ones(error.shape, dtype=bool)
        if self._least is not None:
            before, moved = np.abs(self._least), error - self._least
            told = SIGNIFICANT * noise
            slow = (np.abs(error) > SLOW * before + told) & (np.abs(moved) > told) & (about.filter.robustness[:, None] > 0.0)
            better = np.abs(error) <= GROWTH * before + told
            self._share[~better & ~np.isnan(self._secant)] *= 0.5
            self._secant[slow] = -((tried - self._kept)[slow] / moved[slow])
        measured = ~np.isnan(self._secant)
        self._least = np.where(better, error, error if self._least is None else self._least)
        self._kept = np.where(better, tried, self._kept)
        self._correction = np.where(better, correction, self._correction)
        self._correction[measured] = self._secant[measured] * self._least[measured]
        improved = np.fft.irfft(self._kept + self._share * self._correction, about.filter.period, axis=0)
        return np.clip(improved, -about.limit, about.limit)
