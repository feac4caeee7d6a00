# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Learning of gain and lag of every axis from the feedback's output, for any reference: against drift with temperature.

The feedforward f is continued to f + gain f + lag f', with f' its backward difference. Feedback that repeats the course of f or f' is
what the feedforward lacks (Kawato, Furukawa and Suzuki, "A hierarchical neural-network model for control and learning of voluntary
movement", Biol. Cybern. 57 (1987); Nakanishi and Schaal, "Feedback error learning and nonlinear adaptive control", Neural Networks 17
(2004)). With h the high-pass that takes rest and drift out of both, every tick

    gain += (T / time) h[f] h[u_b] / peak(h[f])²
    lag  += (T / time) h[f]' h[u_b] / peak(h[f]')²

within their bounds, the peaks fading with the same time. A tick moves the gain by no more than T / time of h[u_b] over the peak, so a
wild measurement does little, and the bounds hold whatever it does. Where the feedforward does not move, its peak fades below
`excitation` and the parameters stand still, to the bit. It converges where the loop's complementary sensitivity turns by less than
90°: below its bandwidth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.control.learning.learning_loop import Learner

KEPT = 8192  # Newest rows of the feedforward that wait for what the feedback did in their ticks


@dataclass(frozen=True)
class FeedbackErrorLearning:
    """Description of the learner; `start` makes a running one."""

    sample_time: float
    time: float = 0.2
    corner: float = 1.0
    excitation: float = 1.0
    gain_bound: float = 0.3  # Greatest relative gain, and greatest lag in s, either way
    lag_bound: float = 5e-4

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not np.isfinite(value) or value < 0.0 or value == 0.0 and not name.endswith("bound"):
                raise InputError(f"{name}: must be a finite number above 0, got {value!r}")
        if self.time < self.sample_time:
            raise InputError(f"time: must be at least the sample time, {self.sample_time:g} s, got {self.time:g}")
        if self.gain_bound >= 1.0:
            raise InputError(f"gain_bound: must be below 1, got {self.gain_bound:g}")

    def start(self, axes: int) -> RunningFeedbackErrorLearning:
        """A running learner for this many axes that has learned nothing."""
        return RunningFeedbackErrorLearning(self, axes)


class RunningFeedbackErrorLearning(Learner):
    """The learner's state."""

    def __init__(self, description: FeedbackErrorLearning, axes: int) -> None:
        self.description = given = description
        self.axes = axes
        self._constants = np.array(
            [
                given.sample_time,
                given.sample_time / given.time,
                -np.expm1(-2.0 * np.pi * given.corner * given.sample_time),
                given.excitation**2,
                (2.0 * np.pi * given.corner * given.excitation) ** 2,
                given.gain_bound,
                given.lag_bound,
            ]
        )
        self.reset()

    @property
    def gain(self) -> Array:
        """Learned relative change of the gain (A,)."""
        return np.array(self._parameters[0])

    @property
    def lag(self) -> Array:
        """Learned lag (A,), s."""
        return np.array(self._parameters[1])

    def reset(self) -> None:
        self._parameters = np.zeros((2, self.axes))
        self._state = np.full((6, self.axes), np.nan)  # means of f and u_b, h[f], peaks of h[f] and h[f]', f
        self._given: Array = np.empty((0, self.axes))  # rows that were not observed yet
        self._first = 0
        self._observed: int | None = None

    def available(self, first: int) -> int:
        """Number of rows from tick `first` on that depend on observed ticks only: up to one past the last of these."""
        return max((first if self._observed is None else self._observed) + 1 - first, 0)

    def learned(self, first: int, feedforward: Array) -> Array:
        if self._observed is None:
            self._observed = first
        if first != self._first + len(self._given):
            self._given = self._given[:0]
        if not len(self._given):
            self._first = first
        self._given = np.concatenate([self._given, feedforward])[-KEPT:]
        self._first = first + len(feedforward) - len(self._given)
        before = np.where(np.isnan(self._state[5]), feedforward[0], self._state[5])
        slope = np.diff(feedforward, axis=0, prepend=before[None]) / self.description.sample_time
        self._state[5] = feedforward[-1]
        return np.asarray(self._parameters[0] * feedforward + self._parameters[1] * slope)

    def observe(self, first: int, reference: Array, measurement: Array, feedback: Array) -> None:
        """Learn from the feedback of the ticks from `first` on; ticks without a feedforward are left out."""
        begin, end = max(first, self._first), min(first + len(feedback), self._first + len(self._given))
        if begin < end:
            rows = self._given[begin - self._first : end - self._first]
            _learn(
                rows, np.ascontiguousarray(feedback[begin - first : end - first]), self._constants, self._parameters, self._state
            )
            self._given, self._first = self._given[end - self._first :], end
        if self._observed is not None:
            self._observed = max(self._observed, first + len(feedback))


LARGEST = 1e9  # V, beyond all drives: rows are limited to it, so that no difference of two of them leaves the finite numbers


@njit(cache=True)
def _learn(feedforward: Array, feedback: Array, constants: Array, parameters: Array, state: Array) -> None:
    period, step, passed, least, min_slope, gain_bound, lag_bound = constants
    for k in range(feedforward.shape[0]):
        for axis in range(feedforward.shape[1]):
            value, taught = feedforward[k, axis], feedback[k, axis]
            if not (np.isfinite(value) and np.isfinite(taught)):
                continue
            value, taught = min(max(value, -LARGEST), LARGEST), min(max(taught, -LARGEST), LARGEST)
            if np.isnan(state[0, axis]):
                state[0, axis], state[1, axis], state[2, axis], state[3, axis], state[4, axis] = value, taught, 0.0, 0.0, 0.0
            state[0, axis] += passed * (value - state[0, axis])
            state[1, axis] += passed * (taught - state[1, axis])
            moved, lacking = value - state[0, axis], taught - state[1, axis]
            slope = (moved - state[2, axis]) / period
            state[2, axis] = moved
            state[3, axis] = max((1.0 - step) * state[3, axis], moved * moved)
            state[4, axis] = max((1.0 - step) * state[4, axis], slope * slope)
            if state[3, axis] < least or state[4, axis] < min_slope:
                continue
            gain = parameters[0, axis] + step * moved * lacking / state[3, axis]
            lag = parameters[1, axis] + step * slope * lacking / state[4, axis]
            parameters[0, axis] = min(max(gain, -gain_bound), gain_bound)
            parameters[1, axis] = min(max(lag, -lag_bound), lag_bound)
