# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Devices of bluesky around a control loop: an axis that plans move and read, and a flyer that follows a trajectory.

They keep bluesky's protocols (`Movable`, `Readable`, `Stoppable`, `Flyable`) as ophyd's devices do, and need neither package.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import Annotated, Any

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.labs.control_loop import ControlLoop

POLL = 0.005  # s, between two looks at a move


class Status:
    """End of a move, as bluesky waits for it."""

    def __init__(self) -> None:
        self._ended = threading.Event()
        self._error: Exception | None = None
        self._callbacks: list[Callable[[Status], None]] = []

    @property
    def done(self) -> bool:
        """True once it has ended."""
        return self._ended.is_set()

    @property
    def success(self) -> bool:
        """True once it has ended well."""
        return self.done and self._error is None

    def exception(self, timeout: float | None = 0.0) -> Exception | None:
        """The error that it ended with."""
        self._ended.wait(timeout)
        return self._error

    def wait(self, timeout: float | None = None) -> None:
        """Wait for the end, and raise its error."""
        if not self._ended.wait(timeout):
            raise TimeoutError(f"the move has not ended within {timeout} s")
        if self._error is not None:
            raise self._error

    def add_callback(self, callback: Callable[[Status], None]) -> None:
        """Call a function at the end, or at once where that has come."""
        if self.done:
            callback(self)
        else:
            self._callbacks.append(callback)

    def finish(self, error: Exception | None = None) -> None:
        """End it."""
        self._error = error
        self._ended.set()
        for callback in self._callbacks:
            callback(self)


class PiezoAxis:
    """One axis of a control loop: it has arrived where the measurement stays within `tolerance` of the target for `dwell` s."""

    parent = None

    def __init__(
        self, loop: ControlLoop, axis: str, name: str, tolerance: float, dwell: float = 0.02, timeout: float = 10.0
    ) -> None:
        self.loop, self.name, self.tolerance, self.dwell, self.timeout = loop, name, tolerance, dwell, timeout
        self._index = loop.axes.index(axis)
        self._stopped: Exception | None = None
        self.hints = {"fields": [name]}

    @property
    def position(self) -> float:
        """Measured position."""
        return float(self.loop.measurement[self._index])

    def set(self, value: float) -> Status:
        """Move to a position."""
        status, self._stopped = Status(), None
        self.loop.move(self._index, value)
        threading.Thread(target=self._follow, args=(status, float(value)), daemon=True).start()
        return status

    def stop(self, *, success: bool = False) -> None:
        """Stay where the reference is."""
        self._stopped = None if success else RuntimeError(f"{self.name}: the move was stopped")
        self.loop.move(self._index, self.loop.reference[self._index])

    def read(self) -> dict[str, dict[str, Any]]:
        """Measurement, reference and command."""
        loop, at, now = self.loop, self._index, time.time()
        values = {"": loop.measurement, "_reference": loop.reference, "_command": loop.command}
        return {f"{self.name}{ending}": {"value": float(rows[at]), "timestamp": now} for ending, rows in values.items()}

    def describe(self) -> dict[str, dict[str, Any]]:
        """Units of what `read` gives."""
        units = {"": self.loop.unit, "_reference": self.loop.unit, "_command": "V"}
        return {f"{self.name}{ending}": _described(self.name, unit) for ending, unit in units.items()}

    def read_configuration(self) -> dict[str, dict[str, Any]]:
        """Sample time and tolerance."""
        values = {"sample_time": self.loop.period, "tolerance": self.tolerance}
        return {f"{self.name}_{name}": {"value": value, "timestamp": time.time()} for name, value in values.items()}

    def describe_configuration(self) -> dict[str, dict[str, Any]]:
        """Units of what `read_configuration` gives."""
        units = {"sample_time": "s", "tolerance": self.loop.unit}
        return {f"{self.name}_{name}": _described(self.name, unit) for name, unit in units.items()}

    def _follow(self, status: Status, value: float) -> None:
        begin, within = time.monotonic(), None
        while True:
            now, loop = time.monotonic(), self.loop
            if loop.target[self._index] != value:  # stopped, or sent elsewhere
                return status.finish(self._stopped)
            if loop.fault != "none":
                return status.finish(RuntimeError(f"{self.name}: {loop.fault}"))
            near = abs(self.position - value) <= self.tolerance and loop.reference[self._index] == value
            within = (within or now) if near else None
            if within is not None and now - within >= self.dwell:
                return status.finish()
            if now - begin > self.timeout:
                away = abs(self.position - value)
                return status.finish(TimeoutError(f"{self.name}: {away:.3g} {loop.unit} from {value:g} after {self.timeout:g} s"))
            time.sleep(POLL)


class TrajectoryFlyer:
    """A flyer that follows rows of references, one a tick, and collects reference, command and measurement of every tick."""

    parent = None

    def __init__(self, loop: ControlLoop, name: str, rows: Annotated[Array, "N A"]) -> None:
        self.loop, self.name, self.rows = loop, name, np.asarray(rows, dtype=float).reshape(-1, len(loop.axes))
        self._begun = 0.0

    def kickoff(self) -> Status:
        """Begin."""
        status, refusal = Status(), None
        self._begun = time.time()
        try:
            self.loop.play(self.rows)
        except InputError as error:
            refusal = error
        status.finish(refusal)
        return status

    def complete(self) -> Status:
        """Wait for the last row."""
        status = Status()

        def follow() -> None:
            while self.loop.playing:
                time.sleep(POLL)
            status.finish()

        threading.Thread(target=follow, daemon=True).start()
        return status

    def collect(self) -> Iterator[dict[str, Any]]:
        """An event for every tick."""
        for tick, row in enumerate(self.loop.played):
            moment = self._begun + tick * self.loop.period
            data = {key: float(value) for key, value in zip(self._keys(), row.ravel(), strict=True)}
            yield {"data": data, "timestamps": dict.fromkeys(data, moment), "time": moment}

    def describe_collect(self) -> dict[str, dict[str, dict[str, Any]]]:
        """Units of the events."""
        units = {key: "V" if "_command_" in key else self.loop.unit for key in self._keys()}
        return {self.name: {key: _described(self.name, unit) for key, unit in units.items()}}

    def _keys(self) -> list[str]:
        return [f"{self.name}_{signal}_{axis}" for signal in ("reference", "command", "measurement") for axis in self.loop.axes]


def _described(device: str, unit: str) -> dict[str, Any]:
    """Description of a number, as bluesky has it."""
    return {"source": f"hyst_control:{device}", "dtype": "number", "shape": [], "units": unit}
