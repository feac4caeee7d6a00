# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Side of the actuator under the timer: the newest command through limits and watchdog, one voltage per tick."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import Annotated, Any

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.control.feedback.command_limits import CommandLimits
from hyst_control.control.feedback.command_watchdog import CommandWatchdog
from hyst_control.nodes.signal_node.base import SignalNode
from hyst_control.nodes.signal_node.parameters import Setting
from hyst_control.records.actuator_following import APPLIED, INTERVAL

CLOSE = 1e-9  # V; a voltage that differs by less was not limited
BUNCHED = 0.5  # Share of a tick; two writes that follow each other sooner, behind a late one, change by what that time allows

SAFE_SETTINGS = (
    Setting("safe_command", (0.0,), "V", "actuator without a command, under the timer: one value for all axes or each", -1e6, 1e6),
    Setting("safe_rate", 1000.0, "V/s", "slope towards it, and back to the command", 1e-6, 1e12),
)
"""Parameters of the watchdog."""


class Actuator:
    """Voltages of an actuator, tick by tick, from the commands that a node receives.

    It creates the node's input `command` and its output `applied`, on which it says what is on the actuator while that is not the
    command, for a feedback that starts.
    """

    def __init__(self, node: SignalNode, limits: CommandLimits | None = None) -> None:
        self.node, self.limits = node, limits or CommandLimits()
        self.command = node.input("command", "V")
        self.output = node.output(APPLIED, "V")
        self.limited = 0  # Ticks whose command was beyond the limits
        given, axes = node.settings, len(node.axes)
        if len(given.safe_command) not in (1, axes):
            raise InputError(f"{node.get_name()}: parameter safe_command: {len(given.safe_command)} values, {axes} axes")
        safe = np.broadcast_to(np.array(given.safe_command), axes)
        if np.any(safe < self.limits.lower) or np.any(safe > self.limits.upper):
            raise InputError(
                f"{node.get_name()}: parameter safe_command: must be within lower and upper, {self.limits.lower:g} to "
                f"{self.limits.upper:g} V, got {list(given.safe_command)}"
            )
        self._safe, self._rate = safe, min(given.safe_rate, self.limits.step / node.period)
        self._said = 0  # tick at which it was said last what is applied
        self.start_from(np.zeros(axes))

    def start_from(self, rest: Annotated[Array, "A"]) -> None:
        """Begin anew."""
        self.watchdog = CommandWatchdog(rest, self._safe, self._rate, self.node.period)
        self._last_tick: int | None = None
        self._last_written = -math.inf  # Time, s

    def reset(self) -> None:
        """Return to the start."""
        self.watchdog.reset()

    @property
    def safe(self) -> bool:
        """True when the actuator is at its safe value, or never had a command."""
        return not self.watchdog.armed or bool(np.all(np.abs(self.watchdog.applied - self._safe) <= CLOSE))

    def voltage(self, tick: int, allowed: bool = True) -> Annotated[Array, "A"]:
        """Voltage of a tick, where nothing can keep it from being written."""
        voltage = self.wanted(tick, allowed)
        self.written(voltage)
        return voltage

    def written(self, voltage: Annotated[Array, "A"]) -> None:
        """Take note that a voltage, as `wanted` returned it, is on the actuator."""
        self.watchdog.written(voltage)
        self._last_written = self.node.timer.now

    def wanted(self, tick: int, allowed: bool = True) -> Array:
        """Voltage (A,) to be written in a `tick`, V, the way to the safe value unless `allowed`; inform the watchdog once it is."""
        rows, node = self.command.rows, self.node
        command = rows.newest(tick)
        fresh = rows.behind(tick) * node.period <= node.timer.longest_age
        trusted = allowed and fresh and not self._contradicted and not self._stood_still(tick)
        if command is not None and trusted:
            within = self._present_limits.limited(command, self.watchdog.applied)
            if within is not command:
                self.limited += bool(np.abs(within - command).max() > CLOSE)
                command = within
        return self.watchdog.wanted(command, trusted)

    def report(self, tick: int) -> None:
        """Publish what is on the actuator, unless that is the command, and warn when the watchdog has taken over."""
        watchdog, node = self.watchdog, self.node
        if watchdog.following:
            return
        if watchdog.armed and self.command.rows.behind(tick) * node.period > node.timer.longest_age:
            node.warn("stale", f"no command for {node.timer.longest_age:g} s: the actuator goes to its safe value")
        elif self._contradicted:
            node.warn("contradicted", "two sources of command: the actuator goes to its safe value")
        self.tell(tick)

    def tell(self, tick: int) -> None:
        """Publish what is on the actuator, every `INTERVAL`."""
        if tick - self._said >= INTERVAL / self.node.period:
            self._said = tick
            self.output.send(tick, self.watchdog.applied[None])

    def trouble(self) -> str:
        """Reason for a warning; "" when the actuator follows the command or never had one."""
        if self.watchdog.following or not self.watchdog.armed:
            return ""
        return "no trusted command: the actuator goes to its safe value, or back to the command"

    def status(self) -> dict[str, Any]:
        """Entries of the diagnostics."""
        return {
            "applied [V]": ", ".join(f"{value:.6g}" for value in self.watchdog.applied),
            **({"limited ticks": self.limited} if self.limited else {}),
        }

    def _stood_still(self, tick: int) -> bool:
        """True in the first tick behind so long a stop of this process that the feedback may have gone elsewhere meanwhile."""
        before, self._last_tick = self._last_tick, tick
        seconds = 0.0 if before is None else (tick - before) * self.node.period
        if seconds <= self.node.timer.longest_age:
            return False
        if self.watchdog.armed:
            self.node.warn("stood still", f"this process stood still for {seconds:.3g} s: the command is approached at safe_rate")
        return True

    @property
    def _present_limits(self) -> CommandLimits:
        """The limits, the slope in time where this write follows a late one."""
        if not math.isfinite(self.limits.step):
            return self.limits
        share = (self.node.timer.now - self._last_written) / self.node.period
        return self.limits if share >= BUNCHED else replace(self.limits, step=self.limits.step * max(share, 0.0))

    @property
    def _contradicted(self) -> bool:
        return time.monotonic() - self.command.rows.conflicted < self.node.timer.longest_age
