# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The whole controller on the wall clock in a thread, without ROS, around any driver with `read` and `write`."""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Protocol

import numpy as np
from numpy.typing import ArrayLike

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.export.controller import FAULTS, Controller
from hyst_control.export.programs import controller as described
from hyst_control.model_file import Simulator, load_model

DRIVER = "the driver failed"


class Driver(Protocol):
    """Converter of a stage."""

    def read(self) -> Annotated[Array, "A"]:
        """Measurement of this moment, um or mrad."""

    def write(self, command: Annotated[Array, "A"]) -> None:
        """Put out a command, V."""


class SimulatedDriver:
    """A model file in the place of a stage: one tick passes with every command."""

    def __init__(self, model: str | Path, sample_time: float) -> None:
        found = load_model(model)
        self._simulator = Simulator(found, sample_time)
        self._value = self._simulator.reset(np.zeros(len(found.axes)))

    def read(self) -> Array:
        """Measurement (A,)."""
        return self._value

    def write(self, command: Array) -> None:
        """Advance by a tick with a command (A,), V."""
        self._value = self._simulator.step(command[None])[0]


class ControlLoop:
    """A controller beside a driver, tick by tick; the reference goes to its target no faster than `speed` (unit/s)."""

    def __init__(self, controller: Controller, axes: Sequence[str], unit: str, driver: Driver, speed: float) -> None:
        if not 0 < speed < np.inf:
            raise InputError(f"speed: must be above 0 {unit}/s, got {speed!r}")
        self.axes, self.unit, self.period = tuple(axes), unit, controller.pi.sample_time
        self._controller, self._driver, self._step = controller, driver, speed * self.period
        count = len(self.axes)
        self.target = np.zeros(count)  # Position (A,) that the reference goes to, measurement unit
        self.enabled = True  # False: the command goes to its safe value
        self.reference, self.measurement, self.command = np.zeros(count), np.full(count, np.nan), np.zeros(count)
        self.fault = "none"
        self.ticks = self.missed = 0
        self._played: tuple[Array, list[Array]] = np.empty((0, count)), []
        self._ending = False
        self._thread = threading.Thread(target=self._run, daemon=True)

    @classmethod
    def from_file(cls, parameters: str | Path, driver: Driver, speed: float) -> ControlLoop:
        """The controller of a file of nodes' parameters, as `hyst export` takes it."""
        program = (found := described(parameters)).program
        assert isinstance(found.python, Controller)
        axes = [slot.name.removeprefix("reference_") for slot in program.inputs[: program.axes]]
        return cls(found.python, axes, program.inputs[0].text, driver, speed)

    def start(self) -> None:
        """Take the present position as reference, and run."""
        self.target = self._finite("driver: read()", self._measured())
        self.reference = self.target.copy()
        self._thread.start()

    def move(self, axis: int, position: float) -> None:
        """Send the reference of one axis to a position."""
        target = self.target.copy()
        target[axis] = self._finite("move", position)
        self.target = target

    def stop(self, timeout: float = 10.0) -> None:
        """End the thread, once the command is at its safe value."""
        self._ending = True
        if self._thread.is_alive():
            self._thread.join(timeout)

    def play(self, rows: Annotated[Array, "N A"]) -> None:
        """Follow rows of references, one a tick; `played` has what was measured. It begins where the reference is."""
        rows = self._finite("play", rows).reshape(-1, len(self.axes))
        if not len(rows):
            raise InputError("play: has no rows: give one row of references per tick")
        if np.abs(rows[0] - self.reference).max() > self._step:
            raise InputError(
                f"play: begins at {rows[0].tolist()}, the reference is {self.reference.tolist()} {self.unit}: move there first"
            )
        self.target = rows[-1].copy()
        self._played = rows, []

    @property
    def playing(self) -> bool:
        """True while rows are followed."""
        return len(self._played[1]) < len(self._played[0])

    @property
    def played(self) -> Annotated[Array, "N 3 A"]:
        """Reference, command and measurement of the rows that were followed."""
        return np.array(self._played[1]).reshape(-1, 3, len(self.axes))

    def tick(self) -> None:
        """One tick: read, compute, write."""
        measurement = np.full(len(self.axes), np.nan)
        failed = False
        try:
            measurement = self._measured()
        except Exception:  # whatever a driver raises must not end the loop: it is a missing measurement
            failed = True
        if self.playing:
            wanted = self._played[0][len(self._played[1])]
        else:
            step = np.clip(self.target - self.reference, -self._step, self._step)
            wanted = self.reference + np.where(np.isfinite(self.target), step, np.nan)
        if np.isfinite(wanted).all():  # to the controller another one is a missing reference; the next target goes on from the last
            self.reference = wanted
        row = np.concatenate([wanted, measurement, [float(self.enabled and not self._ending)]])
        out = self._controller.process(row[None])[0]
        command = out[: len(self.axes)]
        try:
            self._driver.write(command.copy())
        except Exception:
            failed = True
        if self.playing:
            self._played[1].append(np.array([self.reference, command, measurement]))
        self.measurement, self.command = measurement, command
        self.fault = FAULTS[int(out[-1])] if not failed or out[-1] else DRIVER
        self.ticks += 1

    def _measured(self) -> Annotated[Array, "A"]:
        """Measurement of this moment; the controller's rows have place for one number per axis, and for nothing else."""
        given = self._driver.read()
        with suppress(TypeError, ValueError):
            if (measurement := np.array(given, dtype=float)).shape == (len(self.axes),):
                return measurement
        raise InputError(
            f"driver: read() gave {' '.join(repr(given).split()):.60}: return one number per axis ({', '.join(self.axes)})"
        )

    def _finite(self, what: str, values: ArrayLike) -> Array:
        """Convert positions, and refuse those that are none."""
        found = np.array(values, dtype=float)
        if not np.isfinite(found).all():
            raise InputError(f"{what}: must be finite {self.unit}, got {found[~np.isfinite(found)][0]}")
        return found

    @property
    def _at_rest(self) -> bool:
        """True when the command is at its safe value, or at 0 V because no measurement has come yet."""
        return self._controller.loop.at_safe_value or not all(self._controller.known)

    def _run(self) -> None:
        due = time.monotonic()
        while not (self._ending and self._at_rest):
            self.tick()
            due += self.period
            late = time.monotonic() - due
            if late > self.period:
                self.missed += int(late / self.period)
                due += int(late / self.period) * self.period
            time.sleep(max(due - time.monotonic(), 0.0))
