# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Base class of nodes that drive a stage: reads the sensor and writes the command at every tick, and keeps what safety asks for."""

from __future__ import annotations

import math
import threading
import time
from collections import Counter
from functools import partial
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.control.feedback.command_limits import CommandLimits
from hyst_control.hardware.driver_thread import Call, DriverThread
from hyst_control.nodes.execution import interrupts
from hyst_control.nodes.execution.run import LONGEST_WIND_DOWN
from hyst_control.nodes.loop.actuator import SAFE_SETTINGS, Actuator
from hyst_control.nodes.signal_node.common_parameters import TIMER
from hyst_control.nodes.signal_node.duration_histogram import Durations
from hyst_control.nodes.signal_node.loop_latency import LoopLatency
from hyst_control.nodes.signal_node.managed import AUTOSTART, UNCONFIGURED, ManagedNode
from hyst_control.nodes.signal_node.parameters import Setting
from hyst_control.nodes.signal_node.signal_ports import Input
from hyst_control.records.stream.foreign_rows import LARGEST_VALUE

READ_PHASE = 0.1  # Share of a tick after its beginning at which the sensor is read; the feedback computes at 0.5
LONGEST_ANSWER = 0.5  # s, for which a tick waits for the driver at most, unless two ticks are longer
LONGEST_CONNECT = 30.0  # s, for which connecting may take, with the first questions
LONGEST_SILENCE = 2.0  # s; a driver that does not answer for longer keeps the node from ending no more
ROUNDING = 0.01
"""Share of the range by which `initial_command` may lie outside it: the converter's steps, and the error of what reads it back."""


class StageNode(ManagedNode):
    """Node in the place of the plant, with a stage behind it. Subclasses implement `read` and `write`.

    At every tick it reads the sensor, publishes that as `measurement` of the tick, and writes the newest command. What `write` gets is
    always finite, within `lower` and `upper`, and never further from what was written last than `slew_limit` allows. All methods for
    the device run in a thread of their own, one after another. docs/hardware.md says what happens without a command and at a failure.
    """

    NAME = "stage"  # Name of the node, unless another one is given
    SETTINGS: tuple[Setting, ...] = (
        Setting("schedule", TIMER, "", "a stage runs on the wall clock", choices=(TIMER,)),
        Setting("block", 1, "samples", "a stage is read tick by tick", 1, 1),
        Setting("lower", 0.0, "V", "lowest voltage that is ever written", -1e6, 1e6),
        Setting("upper", 100.0, "V", "highest voltage that is ever written", -1e6, 1e6),
        Setting("slew_limit", 0.0, "V/s", "greatest slope of what is written, 0 for none", 0.0, 1e12),
        *SAFE_SETTINGS,
        Setting(
            "failures", 100, "ticks", "failed reads or writes in a row after which the node disconnects, 0 for never", 0, 10**9
        ),
        AUTOSTART,
    )
    """A subclass that has parameters of its own adds them: ``SETTINGS = (*StageNode.SETTINGS, Setting(...))``."""

    def __init__(self, name: str = "", **options: Any) -> None:
        super().__init__(name or self.NAME, **options)
        given = self.settings
        if not given.lower < given.upper:
            raise InputError(f"{self.get_name()}: parameter upper: must be above lower, {given.lower:g} V, got {given.upper:g}")
        step = given.slew_limit * self.period or math.inf
        self.measurement = self.output("measurement", self.unit)
        self._actuator = Actuator(self, CommandLimits(given.lower, given.upper, step))
        self._durations = {"read": Durations(), "write": Durations()}
        self._latency = LoopLatency()
        self._failed: Counter[str] = Counter()  # in a row
        self._late: dict[str, Call] = {}  # calls that have not ended in time
        self._driver = DriverThread()
        self._opened = False  # told by the driver's thread
        self._connected = self._ending = False
        self._cut = threading.Event()  # ends the way to the safe value
        self.begin()
        self.schedule.start(READ_PHASE)

    def connect(self) -> None:
        """Open the device, in the transition `configure`; `self.settings`, `self.axes` and `self.unit` are known by then."""

    def disconnect(self) -> None:
        """Close the device, at `safe_command` as far as `write` works; called however the node ends, and an exception is ignored."""

    def initial_command(self) -> ArrayLike:
        """Voltage (A,) that is on the actuator once the device is connected, V; what was written last, at first 0 V, by default."""
        return self._actuator.watchdog.applied

    def read(self) -> ArrayLike | None:
        """Read the sensor."""
        raise NotImplementedError(f"{type(self).__name__} has no read()")

    def write(self, command: Annotated[Array, "A"]) -> None:
        """Write a voltage to the converter."""
        raise NotImplementedError(f"{type(self).__name__} has no write()")

    def configure(self) -> None:
        """Connect, start from the voltage that the actuator has, and read once."""
        if not self._driver.ended(LONGEST_ANSWER):
            raise InputError(self._silence or "is still on the way to its safe command: try again")
        self._driver = DriverThread()
        self._cut.clear()
        self._actuator.start_from(self._actuator.watchdog.applied)  # nothing is written unless there is a command
        try:
            rest, found = self._waited_for(self._driver.call(self._open))
            self._actuator.start_from(self._rest(rest))
            if found is not None:
                self._checked("read", found)
        except BaseException:
            self._driver.end(self._leave)
            self._driver.ended(LONGEST_SILENCE)
            raise
        self._failed.clear()
        self._late.clear()
        self._connected = True

    def clean_up(self) -> None:
        self._connected = False
        self._driver.end(self._leave)

    def tick(self, tick: int) -> None:
        if not self._connected or not all(call.ended() for call in self._late.values()):
            self._wait(tick)
            return
        if self._late:
            late, self._late = self._late, {}
            for what, call in late.items():
                self._succeeded(what, call)  # too old to be used, but what was raised counts
            return
        voltage = self._actuator.wanted(tick, self.working and not self._ending)
        reading = self._driver.call(self._read)  # both at once: the thread is woken once
        writing = self._driver.call(partial(self._write, voltage)) if self._actuator.watchdog.armed else None
        if self._succeeded("read", reading):
            self._publish(tick, reading.result)
        if writing is not None:
            if "read" in self._late:
                writing.cancel()  # it would come late
            else:
                self._succeeded("write", writing)
        self._actuator.report(tick)

    def arrived(self, source: Input, tick: int, stamp: int) -> None:
        self._latency.answered(tick, stamp)

    def wind_down(self) -> None:
        self._ending = True

    @property
    def wound_down(self) -> bool:
        return self._gone or (self._actuator.safe if self._connected else self._driver.ended())

    def close(self) -> None:
        if self._ending:  # it had the time to go to its safe value, or shall not take it
            self._cut.set()
        self.clean_up()
        end = time.monotonic() + LONGEST_WIND_DOWN
        while not self._driver.ended(0.01):
            if self._gone:
                self.get_logger().error(f"{self._silence}: ended without disconnecting; the actuator keeps what it has")
                return
            if time.monotonic() > end:
                self._cut.set()

    def trouble(self) -> str:
        if self._silence:
            return self._silence
        if self.state == UNCONFIGURED and self.ever_active:
            return "the device has failed: call ~/reset to connect again"
        for what, count in self._failed.items():
            if count:
                return f"{what} fails"
        return self._actuator.trouble()

    def status(self) -> dict[str, Any]:
        return {
            "state": self.state,
            **self._actuator.status(),
            **{key: value for what, durations in self._durations.items() for key, value in durations.entries(what).items()},
            **self._latency.entries(),
        }

    def _open(self) -> tuple[ArrayLike, ArrayLike | None]:
        """Connect: the voltage and the measurement that are there; in the driver's thread, as what follows."""
        self.connect()
        self._opened = True
        return self.initial_command(), self.read()

    def _read(self) -> Array | None:
        found = self.read()
        return None if found is None else self._checked("read", found)

    def _write(self, voltage: Array) -> None:
        self.write(voltage.copy())
        self._actuator.written(voltage)

    def _leave(self) -> None:
        """Take the actuator to its safe command while `write` works, and disconnect: the only way to do so."""
        if not self._opened:
            return
        try:
            while not self._actuator.safe and not self._cut.wait(self.period):
                self._write(self._actuator.watchdog.wanted(None))
                self._driver.answers()
        except Exception as error:  # a driver may raise anything
            self.get_logger().error(f"on the way to the safe command, write: {_reason(error)}: the actuator keeps what it has")
        self._opened = False
        try:
            self.disconnect()
        except Exception as error:  # it must not hide why the node disconnects
            self.get_logger().warning(f"disconnect: {_reason(error)}")

    def _waited_for(self, call: Call) -> Any:
        """Result of a call that may take long, unless the node is interrupted meanwhile."""
        end, before = time.monotonic() + LONGEST_CONNECT, interrupts.received()
        while not call.ended(0.1):
            if interrupts.received() and not before:
                raise InputError("interrupted")
            if time.monotonic() > end:
                raise InputError(self._silence)
        if call.error is not None:
            raise call.error
        return call.result

    def _rest(self, found: ArrayLike) -> Array:
        """The voltage (A,) that the actuator has, V; refused when it cannot be one that this node has written."""
        values, limits = self._checked("initial_command", found), self._actuator.limits
        slack = ROUNDING * (limits.upper - limits.lower)
        if not np.all((limits.lower - slack <= values) & (values <= limits.upper + slack)):
            raise InputError(
                f"initial_command() must return what is on the actuator, within lower and upper, {limits.lower:g} to {limits.upper:g} V, "
                f"got {values.tolist()}: convert the readback to V, or bring the actuator there"
            )
        return np.clip(values, limits.lower, limits.upper)

    def _publish(self, tick: int, measured: Array | None) -> None:
        if measured is None:
            self.counts["measurement: none new"] += 1
        elif np.all(np.abs(measured) <= LARGEST_VALUE):
            self._latency.sent(tick)
            self.measurement.send(tick, measured[None])
        else:
            self.drop("measurement", "not finite", f"read() returned {measured.tolist()}")

    def _checked(self, what: str, found: ArrayLike) -> Array:
        values = np.asarray(found, dtype=np.float64).reshape(-1)
        if len(values) != len(self.axes):
            raise InputError(f"{what}() must return {len(self.axes)} values, one per axis ({', '.join(self.axes)}), got {found!r}")
        return values

    def _succeeded(self, what: str, call: Call) -> bool:
        """True when a call of the driver has ended without an exception, which is counted, as its lateness is."""
        if not call.ended(self._patience):
            self._late[what] = call
            self.counts[f"{what}: no answer"] += 1
            return False
        if call.error is None:
            self._durations[what].add(call.seconds)
            self._failed[what] = 0
            return True
        self._failed[what] += 1
        self.counts[f"{what}: failed"] += 1
        reason = f"{what}: {_reason(call.error)}"
        self.warn(f"{what}: failed", reason)
        if self._connected and isinstance(call.error, ConnectionError) and self.settings.failures:
            self.fail(f"the connection is lost, {reason}")
        elif self._connected and 0 < self.settings.failures <= self._failed[what]:
            self.fail(f"{self._failed[what]} failures in a row, {reason}")
        return False

    def _wait(self, tick: int) -> None:
        """Say what is on the actuator while the driver does not answer, or goes to the safe command to disconnect."""
        if self._connected:
            self._actuator.wanted(tick, allowed=False)  # is not written, so the command is approached again afterwards
        if not self._driver.ended():
            self._actuator.tell(tick)

    @property
    def _patience(self) -> float:
        """Time in s for which a tick waits for the driver."""
        return float(max(2.0 * self.timer.interval, min(self.settings.timeout, LONGEST_ANSWER)))

    @property
    def _gone(self) -> bool:
        """True when the driver has not answered for so long that the node ends without it."""
        return self._driver.silent_for > max(LONGEST_SILENCE, 2.0 * self.timer.interval)

    @property
    def _silence(self) -> str:
        """Says that the driver does not answer; "" when it does."""
        seconds = self._driver.silent_for
        return f"driver does not answer since {seconds:.1f} s" if seconds > self._patience else ""


def _reason(error: BaseException) -> str:
    return str(error) or type(error).__name__
