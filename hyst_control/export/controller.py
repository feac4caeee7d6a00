# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A whole controller: feedforward, learned rows, PI feedback, and what the feedback node does about faults; in Python and as C.

It is what `nodes/pi_feedback.py` does under the timer, tick by tick, with a feedforward node before it. A row that is not finite is left
out: the one before stands for it, and after `timeout` it is a fault of every axis. Which axes run and which do not is
`control.safe_loop`, in Python the very one. Before the first complete inputs the command rests at 0 V.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.chain import Filter
from hyst_control.chain.c_code.c_code import CCode, Member, integers, reals
from hyst_control.chain.c_code.texts import c_filled, c_texts
from hyst_control.control.feedback import pi_c_code, sensor_watch_c_code
from hyst_control.control.feedback.loop import Compensator
from hyst_control.control.feedback.pi import PI, RunningPI
from hyst_control.control.feedback.safe_loop import OVERFLOW, SafeLoop, Safety, ticks_in
from hyst_control.control.feedback.sensor_watch import FROZEN, MOTION, OUT_OF_RANGE, SLOW, TURNED, MeasurementWatch
from hyst_control.export.c_source import Slot

C = c_texts(__file__)
NO_FEEDFORWARD = "/* no feedforward */"

FAULTS = ("none", "no reference", "no measurement", OUT_OF_RANGE, FROZEN, OVERFLOW, TURNED)  # Faults by their code
FAULT_CODES = ", ".join(f"{code}: {text}" for code, text in enumerate(FAULTS))


class Feedforward(Compensator, Protocol):
    """Running filter with C, which may look ahead."""

    def c_code(self) -> CCode:
        """The filter in C."""


@dataclass(frozen=True)
class FaultResponse:
    """Answer of the loop to faults; parameters as those of the feedback node."""

    safe_command: tuple[float, ...] = (0.0,)  # V, (A,)
    safe_rate: float = 1000.0  # V/s
    axis_fault: str = "all"  # Axes that go to their safe value when one axis has a fault: "all", or only that one, "own"
    timeout: float = 0.1  # S, after which inputs that are not finite are a fault
    recovery: str = "automatic"  # "automatic" or "manual"
    recovery_time: float = 0.1  # S without a fault, with automatic recovery
    measurement_lower: float = -1e6
    measurement_upper: float = 1e6
    frozen_time: float = 0.1  # S; 0 for never

    def __post_init__(self) -> None:
        for name, choices in (("recovery", ("automatic", "manual")), ("axis_fault", ("all", "own"))):
            if getattr(self, name) not in choices:
                raise InputError(f"{name}: {getattr(self, name)!r} is not one of {', '.join(choices)}")
        if not (np.isfinite(self.safe_rate) and self.safe_rate > 0):
            raise InputError(f"safe_rate: must be a positive rate in V/s, got {self.safe_rate!r}")
        for name in ("timeout", "recovery_time", "frozen_time"):
            if not 0 <= getattr(self, name) < 1e6:
                raise InputError(f"{name}: must be >= 0 and < 1e6 s, got {getattr(self, name)!r}")
        if not self.measurement_lower < self.measurement_upper:
            raise InputError(f"measurement_lower: {self.measurement_lower} is not below measurement_upper {self.measurement_upper}")


class Controller(Filter):
    """The controller running in Python, with `c_code` that gives the same bits.

    `process` takes rows of reference (A), measurement (A) and enable, and returns rows of command (A), feedback (A), feedforward (A)
    and the code of the fault. With a feedforward that previews, the reference is the one `preview` ticks ahead.
    """

    def __init__(
        self, pi: PI, axes: int, response: FaultResponse, feedforward: Feedforward | None = None, learned: Array | None = None
    ) -> None:
        self.hold = "zoh"
        self.axes, self.response, self.feedforward = axes, response, feedforward
        if len(response.safe_command) not in (1, axes):
            raise InputError(f"safe_command: {len(response.safe_command)} values for {axes} axes")
        if learned is not None and (learned.ndim != 2 or learned.shape[1] != axes or not len(learned)):
            raise InputError(f"learned: must be rows by {axes} axes, got shape {learned.shape}")
        self.safe = np.clip(np.broadcast_to(np.array(response.safe_command, dtype=float), axes), pi.lower, pi.upper)
        self.learned = learned
        self.pi = pi
        self.ahead = feedforward.preview if feedforward else 0
        self.timeout, self.recovery, self.frozen = (
            ticks_in(value, pi.sample_time) for value in (response.timeout, response.recovery_time, response.frozen_time)
        )
        self.settle(np.zeros(2 * axes + 1))

    def settle(self, value: Array) -> Array:
        """Begin a run: at rest at 0 V, nothing known of the inputs; the output (3 A + 1,) is 0, whatever the `value` is."""
        given, limits = self.response, (self.pi.lower, self.pi.upper)
        self.controller: RunningPI = self.pi.start(self.axes)
        self.controller.reset(np.zeros(self.axes))
        motion = MOTION * (self.pi.upper - self.pi.lower)
        watch = MeasurementWatch(given.measurement_lower, given.measurement_upper, self.frozen, motion, limits)
        safety = Safety(self.safe, given.safe_rate, self.recovery, given.recovery == "manual", given.axis_fault == "all")
        self.loop = SafeLoop(self.controller, watch, safety)
        self.inputs = np.zeros((2, self.axes))
        self.known, self.age = [False, False], [0, 0]
        self.begun = self.enabled = False
        self.row = self.place = 0
        self.ring = np.zeros((self.ahead + 1, self.axes))
        return np.zeros(3 * self.axes + 1)

    def process(self, block: Array) -> Array:
        return np.array([self._step(row) for row in block]).reshape(len(block), 3 * self.axes + 1)

    def _step(self, row: Array) -> Array:
        axes = self.axes
        for i, given in enumerate((row[:axes], row[axes : 2 * axes])):
            if np.isfinite(given).all():
                self.inputs[i], self.known[i], self.age[i] = given, True, 0
            else:
                self.age[i] = min(self.age[i] + 1, self.timeout + 1)
        enabled = bool(row[2 * axes] > 0.5)
        if enabled and not self.enabled:
            self.loop.faults.clear()
        self.enabled = self.loop.enabled = enabled
        if not all(self.known):
            return np.concatenate([self.controller.command, np.zeros(2 * axes), [0.0]])
        reference, ahead = self._feedforward(self.inputs[0])
        stale = next((FAULTS[i + 1] for i in (0, 1) if self.age[i] > self.timeout), "")
        command, feedback = self.loop.closed(reference[None], self.inputs[1][None].copy(), ahead[None], stale)
        fault = next((fault for fault in self.loop.faults.present if fault), "none")
        return np.concatenate([command[0], feedback[0], ahead, [float(FAULTS.index(fault))]])

    def _feedforward(self, newest: Array) -> tuple[Array, Array]:
        """Reference of this tick, and its feedforward (V)."""
        if not self.begun:
            self.begun = True
            self.ring[:] = newest
            if self.feedforward is not None:
                self.feedforward.settle(newest)
        self.ring[self.place] = newest
        self.place = self.place + 1 if self.place < self.ahead else 0
        ahead = np.zeros(self.axes) if self.feedforward is None else self.feedforward.process(newest[None].copy())[0]
        if self.learned is not None:
            ahead = ahead + self.learned[self.row]
            self.row = (self.row + 1) % len(self.learned)
        return self.ring[self.place].copy(), ahead

    def c_code(self) -> CCode:
        axes, learned = self.axes, self.learned
        limits = {
            "safe": reals(self.safe, "V, command of a stopped loop"),
            "safe_step": reals(self.loop.rate * self.pi.sample_time, "V, on the way to it, in a step"),
            **sensor_watch_c_code.constants(self.loop.watch),
        }
        table = {} if learned is None else {"learned": reals(learned, "V, one period")}
        state: dict[str, Member] = {
            **pi_c_code.state(self.controller),
            "reference": reals(np.zeros(axes), "newest finite one"),
            "measurement": reals(np.zeros(axes), "newest finite one"),
            "ring": reals(self.ring, "references of the ticks to come"),
            **sensor_watch_c_code.state(axes),
            "age": integers([0, 0], "ticks without a finite reference, measurement"),
            "known": integers([0, 0], "1 once there was a reference, a measurement"),
            "begun": integers(0, "1 once the feedforward is settled"),
            "away": integers(np.zeros(axes), "1 where the command is not that of the controller"),
            "overflow": integers(np.zeros(axes), "1 where the arithmetic of the last tick left the finite"),
            "enabled": integers(0, "last enable"),
            "fault": integers(np.zeros(axes), FAULT_CODES),
            "well": integers(np.zeros(axes), "ticks since a fault was last found"),
            "place": integers(0, "in the ring"),
            "row": integers(0, "in the learned period"),
        }
        parts = () if self.feedforward is None else (self.feedforward.c_code(),)
        texts = {
            "SETTLE_FEEDFORWARD": "real rest[AXES];\nPART0_settle(&s->part0, s->reference, rest);" if parts else NO_FEEDFORWARD,
            "STEP_FEEDFORWARD": "PART0_step(&s->part0, s->reference, feedforward);" if parts else NO_FEEDFORWARD,
            "ADD_LEARNED": "/* nothing is learned */" if learned is None else C["LEARNED"],
            "RESUME": pi_c_code.resume(self.controller),
            "STEP_PI": pi_c_code.step(self.controller),
            "WATCH": sensor_watch_c_code.WATCH,
        }
        return CCode(
            "controller",
            c_filled(C["STEP"], texts),
            C["SETTLE"] + sensor_watch_c_code.SETTLE + pi_c_code.reset(self.controller),
            {
                "AHEAD": self.ahead,
                "TIMEOUT": self.timeout,
                "RECOVERY": self.recovery,
                "AUTOMATIC": int(self.response.recovery == "automatic"),
                "STOP_ALL": int(self.response.axis_fault == "all"),
                "FROZEN": self.frozen,
                "SLOW": SLOW * self.frozen,
                "ROWS": 0 if learned is None else len(learned),
                **pi_c_code.sizes(self.controller),
            },
            {**pi_c_code.constants(self.controller), **limits, **table},
            state,
            (*pi_c_code.functions(self.controller), pi_c_code.RAMPED, C["FINITE"], sensor_watch_c_code.RANGES),
            parts,
        )

    def slots(self, axes: tuple[str, ...], unit: str) -> tuple[tuple[Slot, ...], tuple[Slot, ...]]:
        """Inputs and outputs by name."""
        early = f", {self.ahead} ticks ahead" if self.ahead else ""
        inputs = [Slot(f"reference_{axis}", f"{unit}{early}") for axis in axes]
        inputs += [Slot(f"measurement_{axis}", unit) for axis in axes]
        inputs.append(Slot("enable", "1: run, 0: go to the safe command; raising it ends a fault"))
        outputs = [Slot(f"{name}_{axis}", "V") for name in ("command", "feedback", "feedforward") for axis in axes]
        outputs.append(Slot("fault", f"of the first axis that has one, {FAULT_CODES}"))
        return tuple(inputs), tuple(outputs)
