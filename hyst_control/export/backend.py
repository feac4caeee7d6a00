# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Exported C in the place of the Python filters: compiled where a node starts, the same bits in every row."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.chain.c_code.c_code import CCode
from hyst_control.control.feedback import pi_c_code
from hyst_control.control.feedback.loop import Compensator
from hyst_control.control.feedback.pi import PI, RunningPI
from hyst_control.export.c_source import Program, Slot
from hyst_control.export.compiled import CompiledProgram
from hyst_control.export.controller import Feedforward


class CompiledFeedforward(Compensator):
    """A feedforward that runs in C."""

    preview = 0

    def __init__(self, feedforward: Feedforward, axes: int, sample_time: float) -> None:
        self.preview = feedforward.preview
        self._running = _compiled("feedforward", feedforward.c_code(), axes, axes, axes, sample_time)

    def settle(self, value: Array) -> Array:
        return self._running.settle(value)

    def process(self, block: Array) -> Array:
        return self._running.process(block)


class CompiledPI(RunningPI):
    """PI feedback whose steps run in C, on the state that the methods of `RunningPI` work on."""

    def __init__(self, description: PI, axes: int) -> None:
        super().__init__(description, axes)
        code = CCode(
            "pi",
            f"{ROWS}\n{pi_c_code.step(self)}\n{COMMANDS}",
            "out[0] = in[0];",
            pi_c_code.sizes(self),
            constants=pi_c_code.constants(self),
            state=pi_c_code.state(self),
            functions=pi_c_code.functions(self),
        )
        self._running = _compiled("pi_feedback", code, axes, 3 * axes, 2 * axes, description.sample_time)
        rows = len(self._state)
        numbers = rows * axes * np.dtype(float).itemsize
        self._state = self._running.state[:numbers].view(float).reshape(rows, axes)
        # Numbers that are looked at in every tick, and views of the one row: numpy's indexing would cost more than the step.
        self._counted = self._running.numbers("int", numbers)
        self._flags = self._running.numbers("double", 3 * axes * np.dtype(float).itemsize)
        row_in, row_out = self._running.row_in, self._running.row_out
        self._given = row_in[:, :axes], row_in[:, axes : 2 * axes], row_in[:, 2 * axes :]
        self._found = row_out[:, :axes], row_out[:, axes:]
        self.reset()

    def step(
        self, reference: Annotated[Array, "A"], measurement: Annotated[Array, "A"], feedforward: Annotated[Array, "A"]
    ) -> tuple[Array, Array]:
        shape, axes = feedforward.shape, self.axes
        if feedforward.size == axes:
            now, measured, ahead = self._given
            now[:], measured[:], ahead[:] = reference, measurement, feedforward
            self._running.step()
            command, feedback = self._found[0].copy(), self._found[1].copy()
            if len(shape) == 1:
                command, feedback = command[0], feedback[0]
        else:
            given = np.concatenate([part.reshape(-1, axes) for part in (reference, measurement, feedforward)], axis=1)
            found = self._running.process(given)
            command, feedback = found[:, :axes].reshape(shape), found[:, axes:].reshape(shape)
        self.saturated += self._counted[0]
        self._counted[0] = 0
        self.overflowed = ()
        for axis in range(axes):
            if self._flags[axis]:
                self.overflowed = self._overflowed()
                break
        return command, feedback


ROWS = """
const real *reference = in;
const real *measurement = &in[AXES];
const real *feedforward = &in[2 * AXES];
real *feedback = &out[AXES];
"""

COMMANDS = """
for (int i = 0; i < AXES; i++) {
    out[i] = s->command[i];
}
"""


def _compiled(name: str, code: CCode, axes: int, inputs: int, outputs: int, sample_time: float) -> CompiledProgram:
    slots = [tuple(Slot(f"{i}", "") for i in range(count)) for count in (inputs, outputs)]
    return CompiledProgram(Program(name, code, axes, slots[0], slots[1], sample_time, (f"{name} of a node",)))
