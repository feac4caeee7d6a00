# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Learning in a feedforward node: what it needs to hear, when its rows may go out, and the parameters that describe it."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import TYPE_CHECKING

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.control.learning.feedback_error_learning import FeedbackErrorLearning, RunningFeedbackErrorLearning
from hyst_control.control.learning.iterative_learning import IterativeLearning, RunningIterativeLearning
from hyst_control.control.learning.learning_filter import model_filter
from hyst_control.control.learning.learning_loop import Learner, Played, learned_rows
from hyst_control.model_file import load_model
from hyst_control.nodes.signal_node.parameters import settings_of

if TYPE_CHECKING:
    from hyst_control.nodes.signal_node.base import SignalNode

NONE, PLAYED, TRIALS, FEEDBACK_ERROR = "none", "played", "trials", "feedback_error"
SETTINGS = settings_of("feedforward_learning")


def described_learner(given: SimpleNamespace, axes: int, period: float) -> Learner | None:
    """Learner that the parameters of a node describe, None without learning. Raises `InputError` naming the parameter."""
    if given.learning == NONE:
        return None
    if given.learning == FEEDBACK_ERROR:
        return FeedbackErrorLearning(
            period, given.learning_time, given.learning_corner, given.learning_excitation, given.gain_bound, given.lag_bound
        ).start(axes)
    begin = learned_rows(given.learned_file, axes) if given.learned_file else None
    if given.learning == PLAYED:
        if begin is None:
            raise InputError("learned_file: must be given for learning: played")
        return Played(begin)
    if not given.model or not given.learning_period:
        raise InputError("model, learning_period: must be given for learning: trials")
    if begin is not None and len(begin) != given.learning_period:
        raise InputError(f"learned_file: {given.learned_file}: has {len(begin)} rows, learning_period {given.learning_period}")
    learning_filter = model_filter(
        load_model(given.model), given.learning_period, sample_time=period, mode_spread=given.learning_mode_spread
    )
    return IterativeLearning(learning_filter, given.learning_settling, given.learning_averaged).start(begin)


class FeedforwardLearning:
    """Rows of the feedforward that wait until what they depend on was observed.

    It publishes `learned` (V), which is within `feedforward`, and hears `measurement` and `feedback`. In lockstep a row goes out once
    all is observed that it depends on, so that it equals the offline computation; under the timer at once.
    """

    def __init__(self, node: SignalNode, learner: Learner, send: Callable[[int, Array], None]) -> None:
        """`send(tick, rows)` takes the feedforward with what was learned in it."""
        self.learner = learner
        self._node, self._send = node, send
        self.learned = node.output("learned", "V")
        self._observed = () if isinstance(learner, Played) else (node.input("measurement", node.unit), node.input("feedback", "V"))
        self._waiting = _Queue(len(node.axes))
        self._reference = _Queue(len(node.axes))

    def add_reference(self, tick: int, rows: Array) -> None:
        """Store `rows` (N, A) of the reference, in the measurement unit, of the ticks from `tick` on."""
        if self._observed:
            self._reference.add(tick, rows)

    def add(self, tick: int, rows: Array) -> None:
        """Store `rows` (N, A) of the compensator's output, in V, of the ticks from `tick` on."""
        self._waiting.add(tick, rows)

    def advance(self) -> None:
        """Observe what has come, and send what may go out."""
        while self._observe() or self._give():
            pass

    def reset(self) -> None:
        """Forget everything."""
        self.learner.reset()
        self._waiting.clear()
        self._reference.clear()
        self.learned.clear()

    def status(self) -> dict[str, str]:
        """Entries for the diagnostics."""
        learner = self.learner
        if isinstance(learner, RunningFeedbackErrorLearning):
            return {"learned gain": _listed(learner.gain), "learned lag [s]": _listed(learner.lag)}
        if isinstance(learner, RunningIterativeLearning):
            error = f"{learner.history[-1].error:.6g}" if learner.history else "none yet"
            return {
                "trials": str(len(learner.history)),
                "error of the last trial": error,
                "learning stopped": learner.stopped or "no",
            }
        return {}

    def _observe(self) -> bool:
        if not self._observed:
            return False
        rows = [signal.rows for signal in self._observed]
        if any(not each.available for each in rows) or not len(self._reference.rows):
            return False
        first = max(self._reference.first, *(each.start for each in rows))
        for each in rows:
            each.skip_to(first)
        self._reference.skip_to(first)
        if any(not each.available or each.start != first for each in rows) or not len(self._reference.rows):
            return False
        measurement, feedback = (each.take(1) for each in rows)
        self.learner.observe(first, self._reference.take(1), measurement, feedback)
        return True

    def _give(self) -> bool:
        first, count = self._waiting.first, len(self._waiting.rows)
        if self._node.lockstep:
            count = min(count, self.learner.available(first))
        if not count:
            return False
        rows = self._waiting.take(count)
        learned = self.learner.learned(first, rows)
        self.learned.send(first, learned)
        self._send(first, rows + learned)
        return True


class _Queue:
    """Successive rows by tick."""

    def __init__(self, axes: int) -> None:
        self._axes = axes
        self.clear()

    def clear(self) -> None:
        self.first, self.rows = 0, np.empty((0, self._axes))

    def add(self, tick: int, rows: Array) -> None:
        """Rows from `tick` on; where ticks are missing before them, those that waited are dropped."""
        if tick != self.first + len(self.rows):
            self.first, self.rows = tick, self.rows[:0]
        self.rows = np.concatenate([self.rows, rows])

    def take(self, count: int) -> Array:
        taken, self.rows = self.rows[:count], self.rows[count:]
        self.first += count
        return taken

    def skip_to(self, tick: int) -> None:
        self.take(min(max(tick - self.first, 0), len(self.rows)))


def _listed(values: Array) -> str:
    return ", ".join(f"{value:.6g}" for value in values)
