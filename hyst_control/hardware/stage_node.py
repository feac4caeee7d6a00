"""Base class of nodes that drive a stage: reads the sensor and writes the command at every tick, and keeps what safety asks for."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hyst_control.control.command_limits import CommandLimits
from hyst_control.errors import InputError
from hyst_control.nodes.actuator import SAFE_SETTINGS, Actuator
from hyst_control.nodes.common_parameters import TIMER
from hyst_control.nodes.duration_histogram import Durations
from hyst_control.nodes.loop_latency import LoopLatency
from hyst_control.nodes.managed import AUTOSTART, UNCONFIGURED, ManagedNode
from hyst_control.nodes.parameters import Setting
from hyst_control.nodes.signal_ports import Input
from hyst_control.records.foreign_rows import LARGEST_VALUE

Array = NDArray[np.float64]

READ_PHASE = 0.1
"""Share of a tick after its beginning at which the sensor is read; the feedback computes at 0.5."""


class StageNode(ManagedNode):
    """Node in the place of the plant, with a stage behind it. Subclasses implement `read` and `write`.

    At every tick, floor(CLOCK_MONOTONIC / period), it reads the sensor, publishes that as `measurement` of the tick, and writes the
    newest command. The command that follows from a measurement is so written one tick after it, which identification finds as a
    delay. What `write` gets is always finite, within `lower` and `upper`, and never further from the last than `slew_limit` allows;
    without a trusted command for `timeout`, after `~/stop`, in every state but active and at the node's end it goes to
    `safe_command` at `safe_rate`. Before the first command nothing is written.

    A `read` or `write` that raises is counted and logged; the feedback goes to its safe value when measurements stay away. After
    `failures` in a row the node disconnects and waits to be configured again (`~/reset`); after a `ConnectionError` it does so at once.
    With `failures` 0 it never does.

    Parameters
    ----------
    name : str
        Name of the node; default: `NAME`.
    **options : object
        Passed on to `rclpy.node.Node`.
    """

    NAME = "stage"
    """Name of the node, unless another one is given."""
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
        self._connected = self._ending = False
        self.begin()
        self.start_timer(READ_PHASE)

    def connect(self) -> None:
        """Open the device, in the transition `configure`; `self.settings`, `self.axes` and `self.unit` are known by then."""

    def disconnect(self) -> None:
        """Close the device; called however the node ends, and also when the device has failed. An exception is logged and ignored."""

    def initial_command(self) -> ArrayLike:
        """Voltage (A,) that is on the actuator when the node starts, V; 0 V unless a subclass knows better."""
        return np.zeros(len(self.axes))

    def read(self) -> ArrayLike | None:
        """Read the sensor.

        Returns
        -------
        array_like, shape (A,), or None
            Measurement of the present moment in the node's `unit`, one value per axis; None when the device has no new one.
        """
        raise NotImplementedError(f"{type(self).__name__} has no read()")

    def write(self, command: Array) -> None:
        """Write a voltage to the converter.

        Parameters
        ----------
        command : ndarray, shape (A,)
            Voltage of each axis, V; held until the next call.
        """
        raise NotImplementedError(f"{type(self).__name__} has no write()")

    def configure(self) -> None:
        """Connect, start from the voltage that the actuator has, and read once.

        Raises
        ------
        InputError
            When the device gives a voltage or a measurement of another form.
        """
        try:
            self.connect()
            self._connected = True
            self._actuator.start_from(self._checked("initial_command", self.initial_command()))
            found = self.read()
            if found is not None:
                self._checked("read", found)
        except BaseException:
            self.clean_up()
            raise
        self._failed.clear()

    def clean_up(self) -> None:
        if self._connected:
            self._connected = False
            try:
                self.disconnect()
            except Exception as error:  # a driver may raise anything; it must not hide why the node disconnects
                self.get_logger().warning(f"disconnect: {str(error) or type(error).__name__}")

    def tick(self, tick: int) -> None:
        if not self._connected:
            return
        measured = self._attempt("read", self._measured)
        if measured is not None:
            self._latency.sent(tick)
            self.measurement.send(tick, measured[None])
        voltage = self._actuator.voltage(tick, self.working and not self._ending)
        if self._actuator.watchdog.armed and self._connected:
            self._attempt("write", lambda: self.write(voltage.copy()))
        self._actuator.report(tick)

    def arrived(self, source: Input, tick: int, stamp: int) -> None:
        self._latency.answered(tick, stamp)

    def reset(self) -> None:
        """Forget received commands; what is on the actuator stays where it is."""

    def wind_down(self) -> None:
        self._ending = True

    @property
    def wound_down(self) -> bool:
        return self._actuator.safe or not self._connected

    def close(self) -> None:
        self.clean_up()

    def trouble(self) -> str:
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

    def _measured(self) -> Array | None:
        """The sensor's values (A,); None when there is no new or no usable one."""
        found = self.read()
        if found is None:
            self.counts["measurement: none new"] += 1
            return None
        values = self._checked("read", found)
        if not np.all(np.abs(values) <= LARGEST_VALUE):
            self.drop("measurement", "not finite", f"read() returned {values.tolist()}")
            return None
        return values

    def _checked(self, what: str, found: ArrayLike) -> Array:
        values = np.asarray(found, dtype=np.float64).reshape(-1)
        if len(values) != len(self.axes):
            raise InputError(f"{what}() must return {len(self.axes)} values, one per axis ({', '.join(self.axes)}), got {found!r}")
        return values

    def _attempt(self, what: str, call: Callable[[], Array | None]) -> Array | None:
        """Result of a call of the device; None when it fails, which is counted."""
        begin = time.monotonic()
        try:
            result = call()
        except Exception as error:  # a driver may raise anything
            self._failed[what] += 1
            self.counts[f"{what}: failed"] += 1
            reason = f"{what}: {str(error) or type(error).__name__}"
            self.warn(f"{what}: failed", reason)
            if isinstance(error, ConnectionError) and self.settings.failures:
                self.fail(f"the connection is lost, {reason}")
            elif 0 < self.settings.failures <= self._failed[what]:
                self.fail(f"{self._failed[what]} failures in a row, {reason}")
            return None
        self._durations[what].add(time.monotonic() - begin)
        self._failed[what] = 0
        return result
