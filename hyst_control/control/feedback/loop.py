# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The control loop computed offline: what the nodes do in lockstep, to the last bit."""

from __future__ import annotations

from typing import Annotated, Protocol

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.control.feedback.pi import RunningPI


class Plant(Protocol):
    """Common interface of a simulator and a reference simulation."""

    def reset(self, command: Array) -> Array:
        """Settle at the command (A,) in V; measurement[0] (A,)."""

    def step(self, commands: Array) -> Array:
        """Advance by commands (N, A) in V; measurements (N, A) at the ticks that follow them."""


class Compensator(Protocol):
    """A feedforward: a streaming filter from the reference to the command in V that looks `preview` ticks ahead.

    Its output belongs to the reference `preview` rows back, so the first `preview` rows it returns precede tick 0.
    """

    @property
    def preview(self) -> int:
        """Ticks that it looks ahead."""

    def settle(self, value: Array) -> Array:
        """Come to rest at the reference `value` (A,)."""

    def process(self, block: Array) -> Array:
        """Turn a block of reference rows (N, A) into feedforward rows (N, A) of the ticks `preview` earlier."""


def feedforward_rows(reference: Array, compensator: Compensator) -> Array:
    """Feedforward (N, A) in V of a reference (N, A) whose last value is held on, by a compensator."""
    compensator.settle(reference[0])
    ahead = compensator.preview
    held = np.concatenate([reference, np.repeat(reference[-1:], ahead, axis=0)]) if ahead else reference
    return compensator.process(np.ascontiguousarray(held))[ahead:]


def run_loop(
    reference: Annotated[Array, "N A"],
    compensator: Compensator | None,
    controller: RunningPI,
    plant: Plant,
    feedback: bool = True,
    start: str = "rest",
) -> dict[str, Array]:
    """Run a control loop for N ticks."""
    # start: "rest", the plant settled at 0 V, or "first_command", settled at the first command (open loop only: a closed loop needs
    # a measurement before it has a command)
    ahead = feedforward_rows(reference, compensator) if compensator else np.zeros_like(reference)
    rest = np.zeros(reference.shape[1])
    controller.reset(rest if start == "rest" else None)
    if not feedback:
        command, correction = controller.pass_through(ahead)
        first = plant.reset(rest if start == "rest" else command[0])
        measurement = np.concatenate([first[None], plant.step(command)[:-1]])
    else:
        if start != "rest":
            raise ValueError("a closed loop starts at rest: it needs a measurement before its first command")
        command, correction, measurement = (np.empty_like(reference) for _ in range(3))
        sample = plant.reset(rest)
        for k in range(len(reference)):
            measurement[k] = sample
            command[k], correction[k] = controller.step(reference[k], sample, ahead[k])
            sample = plant.step(command[k : k + 1])[0]
    return {"reference": reference, "feedforward": ahead, "feedback": correction, "command": command, "measurement": measurement}
