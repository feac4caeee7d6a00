"""What learners of a feedforward have in common, and the loop with one of them computed offline, to the last bit of the nodes'.

A learner adds to the feedforward what it has learned from the loop so far. Rows belong to ticks, so that it does not matter how
they are cut, nor how far ahead the feedforward runs: `available` says how many rows do not depend on what is yet to be observed.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np

from hyst_control.chain.stage import Array
from hyst_control.control.loop import Compensator, Plant, feedforward_rows
from hyst_control.control.pi import RunningPI

ENDLESS = 2**31
"""Rows that are available of what changes no more."""


class Learner(Protocol):
    """What adds to a feedforward."""

    def available(self, first: int) -> int:
        """How many rows from tick `first` on do not depend on ticks that were not observed yet."""

    def learned(self, first: int, feedforward: Array) -> Array:
        """What to add (N, A), in V, to the feedforward (N, A) in V of the ticks from `first` on; each tick once, in order."""

    def observe(self, first: int, reference: Array, measurement: Array, feedback: Array) -> None:
        """What the loop did in the ticks from `first` on: (N, A) in the measurement unit, and in V."""

    def reset(self) -> None:
        """Forget everything that was learned."""


class Played:
    """What was learned before, one period (N, A) in V, played again and again; it learns nothing."""

    def __init__(self, feedforward: Array) -> None:
        self.feedforward = np.array(feedforward, dtype=float)
        self.reset()

    def reset(self) -> None:
        """Begin with the period's first row again."""
        self._origin: int | None = None

    def available(self, first: int) -> int:
        """How many rows from tick `first` on may be given: all."""
        return ENDLESS

    def learned(self, first: int, feedforward: Array) -> Array:
        """What to add (N, A) in V in the ticks from `first` on."""
        if self._origin is None:
            self._origin = first
        start = first - self._origin
        rows: Array = self.feedforward[np.arange(start, start + len(feedforward)) % len(self.feedforward)]
        return rows

    def observe(self, first: int, reference: Array, measurement: Array, feedback: Array) -> None:
        """Nothing is learned."""


def run_learning_loop(
    reference: Array, compensator: Compensator | None, controller: RunningPI, plant: Plant, learner: Learner
) -> dict[str, Array]:
    """Signals by topic, each (N, A), of N ticks of the closed loop from rest at 0 V; `learned` is within `feedforward`.

    Parameters
    ----------
    reference:
        Measurement unit, (N, A).
    compensator:
        Without one there is what is learned alone.
    controller, plant, learner:
        What closes the loop, is moved, and learns. The learner goes on from what it knows.
    """
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
