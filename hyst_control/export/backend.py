"""Exported C in the place of the Python filters: compiled where a node starts, the same bits in every row."""

from __future__ import annotations

import numpy as np

from hyst_control.chain.c_code import CCode
from hyst_control.chain.parameter import Array
from hyst_control.control import pi_c_code
from hyst_control.control.pi import PI, RunningPI
from hyst_control.export.c_source import Program, Slot
from hyst_control.export.compiled import CompiledProgram
from hyst_control.export.controller import Feedforward


class CompiledFeedforward:
    """A feedforward that runs in C.

    Parameters
    ----------
    feedforward
        Running filter with C.
    axes
        Number of axes.
    sample_time
        s.

    Raises
    ------
    InputError
        A stage has no C, or there is no compiler.
    """

    def __init__(self, feedforward: Feedforward, axes: int, sample_time: float) -> None:
        self.preview = feedforward.preview
        self._running = _compiled("feedforward", feedforward.c_code(), axes, axes, axes, sample_time)

    def settle(self, value: Array) -> Array:
        """Come to rest at the reference `value` (A,)."""
        return self._running.settle(value)

    def process(self, block: Array) -> Array:
        """Turn a `block` of reference rows (N, A) into feedforward rows (N, A) of the ticks `preview` earlier."""
        return self._running.process(block)


class CompiledPI(RunningPI):
    """PI feedback whose steps run in C, on the state that the methods of `RunningPI` work on.

    Parameters
    ----------
    description
        Gains and limits.
    axes
        Number of axes.

    Raises
    ------
    InputError
        There is no compiler.
    """

    def __init__(self, description: PI, axes: int) -> None:
        super().__init__(description, axes)
        code = CCode(
            "pi",
            f"{ROWS}\n{pi_c_code.STEP}\n{COMMANDS}",
            "out[0] = in[0];",
            constants=pi_c_code.constants(self),
            state=pi_c_code.state(self),
            functions=pi_c_code.CLAMPING,
        )
        self._running = _compiled("pi_feedback", code, axes, 3 * axes, 2 * axes, description.sample_time)
        rows = len(self._state)
        numbers = rows * axes * np.dtype(float).itemsize
        self._state = self._running.state[:numbers].view(float).reshape(rows, axes)
        self._counted = self._running.state[numbers : numbers + 4].view(np.int32)
        self.reset()

    def step(self, reference: Array, measurement: Array, feedforward: Array) -> tuple[Array, Array]:
        """Command and feedback of the next ticks; see `RunningPI.step`.

        Parameters
        ----------
        reference, measurement
            (A,) or (N, A), measurement unit.
        feedforward
            (A,) or (N, A), V.
        """
        shape, axes = feedforward.shape, self.axes
        if feedforward.size == axes:
            row = self._running.row_in[0]
            row[:axes], row[axes : 2 * axes], row[2 * axes :] = reference.ravel(), measurement.ravel(), feedforward.ravel()
            self._running.step()
            found = self._running.row_out.copy()
        else:
            given = np.concatenate([part.reshape(-1, axes) for part in (reference, measurement, feedforward)], axis=1)
            found = self._running.process(given)
        self.saturated += int(self._counted[0])
        self._counted[0] = 0
        self.overflowed = self._overflowed() if self._state[3].any() else ()
        return found[:, :axes].reshape(shape), found[:, axes:].reshape(shape)


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
