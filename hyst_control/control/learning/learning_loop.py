# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Interface of the learners of a feedforward, and the loop with a learner computed offline, bit by bit as the nodes compute it.

A learner adds to the feedforward what it has learned from the loop so far. Rows belong to ticks, so that it does not matter how
they are cut, nor how far ahead the feedforward runs: `available` says how many rows do not depend on what is yet to be observed.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.control.feedback.loop import Compensator, Plant, feedforward_rows
from hyst_control.control.feedback.pi import RunningPI

ENDLESS = 2**31  # Rows that are available of what changes no more


class Learner(Protocol):
    """Learned correction of a feedforward."""

    def available(self, first: int) -> int:
        """Number of rows from tick `first` on that do not depend on ticks that were not observed yet."""

    def learned(self, first: int, feedforward: Array) -> Array:
        """Correction (N, A) in V of the feedforward (N, A) in V of the ticks from `first` on; ask for each tick once, in order."""

    def observe(self, first: int, reference: Array, measurement: Array, feedback: Array) -> None:
        """Learn from the loop's signals (N, A) of the ticks from `first` on."""

    def reset(self) -> None:
        """Forget everything that was learned."""


class Played(Learner):
    """Learned feedforward of one period (N, A) in V that is played again and again; it learns nothing."""

    def __init__(self, feedforward: Array) -> None:
        self.feedforward = np.array(feedforward, dtype=float)
        self.reset()

    def reset(self) -> None:
        self._origin: int | None = None

    def available(self, first: int) -> int:
        return ENDLESS

    def learned(self, first: int, feedforward: Array) -> Array:
        if self._origin is None:
            self._origin = first
        start = first - self._origin
        return np.asarray(self.feedforward[np.arange(start, start + len(feedforward)) % len(self.feedforward)])

    def observe(self, first: int, reference: Array, measurement: Array, feedback: Array) -> None:
        """Ignore `reference`, `measurement` and `feedback` (N, A) of the ticks from `first` on."""


def run_learning_loop(
    reference: Array, compensator: Compensator | None, controller: RunningPI, plant: Plant, learner: Learner
) -> dict[str, Array]:
    """Signals by topic, each (N, A), of N ticks of the closed loop from rest at 0 V; `learned` is within `feedforward`."""
    ahead = feedforward_rows(reference, compensator) if compensator else np.zeros_like(reference)
    rest = np.zeros(reference.shape[1])
    controller.reset(rest)
    sample = plant.reset(rest)
    learned, feedforward, feedback, command, measurement = np.empty((5, *reference.shape))
    for k in range(len(reference)):
        now = slice(k, k + 1)
        learned[k] = learner.learned(k, ahead[now])[0]
        feedforward[k] = ahead[k] + learned[k]
        measurement[k] = sample
        command[k], feedback[k] = controller.step(reference[k], sample, feedforward[k])
        learner.observe(k, reference[now], measurement[now], feedback[now])
        sample = plant.step(command[now])[0]
    return {
        "reference": reference,
        "learned": learned,
        "feedforward": feedforward,
        "feedback": feedback,
        "command": command,
        "measurement": measurement,
    }


def learned_rows(path: str, axes: int) -> Array:
    """Rows (N, A) of a learned feedforward from the file of `hyst learn`."""
    try:
        rows = np.asarray(np.load(path), dtype=float)
    except (OSError, ValueError) as error:
        raise InputError(f"learned_file: {path}: {error}: give an .npy file as hyst learn writes it") from None
    if rows.ndim != 2 or rows.shape[1] != axes or not len(rows) or not np.isfinite(rows).all():
        raise InputError(f"learned_file: {path}: must be finite rows by {axes} axes, got shape {rows.shape}")
    return rows
