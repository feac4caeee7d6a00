# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The feedback loop with its faults: which axes run, which go to their safe value, and how they come back, without ROS.

Every row that comes out lies within the controller's limits, follows on the last one within its slew limit, and is finite, whatever
comes in. An axis is in one of four states:

=========  ==========================================================  =====================================================
state      its command                                                 it ends
=========  ==========================================================  =====================================================
running    of the controller                                           with a fault, or when the loop is disabled
stopped    goes to its safe value at the safe rate, and stays there    when no fault was there for the recovery time, or with
                                                                       manual recovery at `restart`
tracking   goes to what is applied, as fast as the slew limit allows   when the actuator follows its command
returning  of the controller, taken over without a jump; without       when it is that of the controller
           integral action (which could not lead back) and in open
           loop at the safe rate
=========  ==========================================================  =====================================================

A fault of the whole loop stops every axis. A fault of one axis stops it alone, or every axis where `Safety.stop_all` is set: axes of one
stage are seldom independent.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array, Mask
from hyst_control.control.feedback.pi import PI, RunningPI
from hyst_control.control.feedback.sensor_watch import MeasurementWatch

OVERFLOW = "numbers too large to compute with"


def ticks_in(seconds: float, period: float) -> int:
    """Whole ticks of a `period`, s, that last so many `seconds` at least."""
    return math.ceil(seconds / period - 1e-9)


@dataclass(frozen=True)
class Safety:
    """Behavior of a stopped axis, and the end of its stop."""

    command: Annotated[Array, "A"]  # Safe value, V
    rate: float  # Slope towards it, V/s
    # Ticks without a fault after which a stopped axis returns; with `manual` it waits for `SafeLoop.restart`
    recovery_ticks: int = 0
    manual: bool = False  # Whether it waits
    stop_all: bool = True  # Whether the fault of one axis stops all


class AxisFaults:
    """Faults of the axes in time: each lasts until none was there for the recovery time, or until it is cleared."""

    def __init__(self, axes: int) -> None:
        self.present = [""] * axes  # The fault of each axis, "" for none
        self._well = [0] * axes
        self.raised = 0  # Number of faults that have begun

    @property
    def any(self) -> bool:
        """True when an axis has a fault."""
        return any(self.present)

    def clear(self) -> None:
        """Take every axis for well."""
        axes = len(self.present)
        self.present, self._well = [""] * axes, [0] * axes

    def update(self, faults: Sequence[str], ticks: int, safety: Safety) -> None:
        """Take in what was found."""
        for axis, fault in enumerate(faults):
            if fault:
                self.raised += fault != self.present[axis]
                self.present[axis], self._well[axis] = fault, 0
            elif self.present[axis]:
                self._well[axis] += max(ticks, 1)
                if not safety.manual and self._well[axis] >= safety.recovery_ticks:
                    self.present[axis] = ""


class SafeLoop:
    """The controller, the watch over its measurement, and the faults."""

    def __init__(self, controller: RunningPI, watch: MeasurementWatch, safety: Safety) -> None:
        self.controller, self.watch, self.safety = controller, watch, safety
        self.faults = AxisFaults(controller.axes)
        self.enabled = True  # False: every axis is stopped, without a fault
        self.applied: Array | None = None
        """Voltage (A,) of the axes whose actuator does not follow the command, NaN of the others; None while all follow."""
        self._away = np.zeros(controller.axes, bool)  # stopped, or returning
        self._well = True  # no axis is away or has a fault
        self._overflowed: tuple[int, ...] = ()
        self._limits: tuple[float, float] | None = None  # V, towards which those of the controller move after a change

    def change(self, description: PI) -> None:
        """Go on with another description of the controller, without a jump of the command: limits and gains move at the safe rate."""
        old, command = self.controller.description, self.controller.command
        within = command[np.isfinite(command)]
        lowest, highest = (within.min(), within.max()) if len(within) else (old.lower, old.upper)
        lower = old.lower if description.lower < old.lower else min(description.lower, max(lowest, old.lower))
        upper = old.upper if description.upper > old.upper else max(description.upper, min(highest, old.upper))
        lower = min(lower, upper - self.safety.rate * old.sample_time)  # the command is at both
        moving = (lower, upper) != (description.lower, description.upper)
        self._limits = (description.lower, description.upper) if moving and len(within) else None
        self.controller.change(replace(description, lower=lower, upper=upper) if self._limits else description)
        led = not description.ki and (old.kp, old.ki, old.roll_off) != (description.kp, 0.0, description.roll_off)
        if led and len(within):  # nothing but a ramp would lead there
            self._away[:] = True
            self._well = False

    def _move_limits(self) -> None:
        """Bring the limits nearer to those that they are to have, by one tick."""
        assert self._limits is not None
        now = self.controller.description
        step = self.safety.rate * now.sample_time
        lower, upper = (_towards(target, value, step) for target, value in zip(self._limits, (now.lower, now.upper), strict=True))
        self.controller.limit(lower, upper)
        if (lower, upper) == self._limits:
            self._limits = None

    @property
    def rate(self) -> float:
        """Slope of the ramps, V/s: the safe rate, but never above the slew limit."""
        return float(min(self.safety.rate, self.controller.description.slew_limit or np.inf))

    @property
    def away(self) -> bool:
        """True when the command of an axis is not that of the controller."""
        return bool(self._away.any())

    @property
    def at_safe_value(self) -> bool:
        """True when every axis is stopped and its command is the safe value."""
        return bool(self._away.all() and np.array_equal(self.controller.command, self._safe))

    def restart(self, command: Array | None, away: bool) -> None:
        """Clear all faults and forget the integral."""
        self.controller.reset(command)
        self.faults.clear()
        self._overflowed = ()
        self._away[:] = away
        self._well = not away

    def closed(
        self,
        reference: Annotated[Array, "1 A"],
        measurement: Annotated[Array, "1 A"],
        feedforward: Annotated[Array, "1 A"],
        fault: str = "",
    ) -> tuple[Array, Array]:
        """Command and feedback of one tick in closed loop."""
        if self._limits is not None:
            self._move_limits()
        last = self.controller.command
        found: Sequence[str] = ()
        if self.applied is None:
            asked = reference if self._well else np.where(self._away, measurement, reference)  # of a stopped axis nothing is asked
            found = self.watch.check(measurement[0], last, asked[0])
        else:  # what is measured is no answer to the command
            self.watch.forget()
        if self._well and self.enabled and self.applied is None and not fault and not found and not self._overflowed:
            command, feedback = self.controller.step(reference, measurement, feedforward)
            self._overflowed = self.controller.overflowed
            return command, feedback
        running = self._running(fault, found, 1)
        if not running.any():
            return self._to_safe(1)
        tracking = running & np.isfinite(self.applied) if self.applied is not None else np.zeros_like(running)
        return self._partly(running & ~tracking, tracking, last, reference, measurement, feedforward)

    def open(self, feedforward: Annotated[Array, "N A"], fault: str = "") -> tuple[Array, Array]:
        """Command and feedback (zeros) of successive ticks in open loop."""
        if self._limits is not None:
            if len(feedforward) > 1:
                rows = [self.open(row[None], fault) for row in feedforward]
                return np.concatenate([command for command, _ in rows]), np.zeros_like(feedforward)
            self._move_limits()
        if not (self._well and self.enabled and not fault and not self._overflowed):
            running = self._running(fault, (), len(feedforward))
            if not running.all():
                return self._open_partly(running, feedforward)
        led = self._led_back(feedforward) if self.away else np.empty((0, self.controller.axes))
        command, feedback = self.controller.pass_through(feedforward[len(led) :])
        self._overflowed = self.controller.overflowed
        if len(led):
            return np.concatenate([led, command]), np.zeros_like(feedforward)
        return command, feedback

    def stopped_by(self, fault: str, ticks: int) -> tuple[Array, Array]:
        """Command (ticks, A) on the way to the safe value, in V, and a feedback of zeros, for a reason."""
        if self._limits is not None:
            self._move_limits()
        self._running(fault, (), ticks)
        return self._to_safe(ticks)

    def _to_safe(self, ticks: int) -> tuple[Array, Array]:
        """Command and feedback on the way to the safe value; the limits are those of the first of the ticks."""
        self._away[:] = True
        self._well = False
        rows: list[Array] = []
        while self._limits is not None and len(rows) < ticks - 1:
            rows.extend(self.controller.ramp(self._safe, self.rate))
            self._move_limits()
        rows.extend(self.controller.ramp(self._safe, self.rate, ticks - len(rows)))
        command = np.array(rows)
        return command, np.zeros_like(command)

    @property
    def _safe(self) -> Array:
        limits = self.controller.description
        return np.asarray(np.clip(self.safety.command, limits.lower, limits.upper), dtype=float)

    def _running(self, fault: str, found: Sequence[str], ticks: int) -> Mask:
        """Mask (A,) of the axes that may run, after taking in the faults of the loop and of the axes."""
        axes = self.controller.axes
        of_axes = list(found) or [""] * axes
        for axis in self._overflowed:
            of_axes[axis] = of_axes[axis] or OVERFLOW
        self._overflowed = ()
        self.faults.update([fault or own for own in of_axes], ticks, self.safety)
        stopped = np.array([bool(each) for each in self.faults.present])
        if not self.enabled or self.safety.stop_all and stopped.any():
            stopped[:] = True
        self._well = not stopped.any() and not self.away
        return ~stopped

    def _partly(
        self, running: Mask, tracking: Mask, last: Array, reference: Array, measurement: Array, feedforward: Array
    ) -> tuple[Array, Array]:
        """Closed loop in which axes are stopped, track what is applied, or return."""
        controller = self.controller
        back = running & self._away
        controller.resume(last, reference[0], measurement[0], feedforward[0], back)
        command, feedback = controller.step(reference, measurement, feedforward)
        self._overflowed = tuple(axis for axis in controller.overflowed if running[axis])
        wanted = command[0].copy()
        led = ~running if controller.description.ki else ~running | back  # without integral action nothing else would lead back
        if led.any():
            controller.hold(np.where(led, last, wanted))
            target, rate = np.where(running, wanted, self._safe), np.full(len(last), self.rate)
            if self.applied is not None:
                target[tracking], rate[tracking] = self.applied[tracking], controller.description.slew_limit or np.inf
            command[0] = np.where(led, controller.ramp(target, rate)[0], wanted)
            controller.hold(command[0])
            feedback[0][~running] = 0.0
        self._away = ~running | led & (command[0] != wanted)
        self._well = not self._away.any() and not self.faults.any
        return command, feedback

    def _led_back(self, feedforward: Array) -> Array:
        """Commands (n, A), as many of the N as it takes to come from the last one to the feedforward at the safe rate."""
        limits, rows = self.controller.description, []
        for row in feedforward:
            target = np.where(np.isfinite(row), np.clip(row, limits.lower, limits.upper), self.controller.command)
            rows.append(self.controller.ramp(target, self.rate)[0])
            if np.array_equal(rows[-1], target):
                self._away[:] = False
                self._well = not self.faults.any
                break
        return np.array(rows)

    def _open_partly(self, running: Mask, feedforward: Array) -> tuple[Array, Array]:
        """Open loop in which axes are stopped: row by row, each axis towards its own target at the safe rate."""
        if not running.any():
            return self._to_safe(len(feedforward))
        limits, rows = self.controller.description, []
        for row in feedforward:
            last = self.controller.command
            wanted = np.where(np.isfinite(row), np.clip(row, limits.lower, limits.upper), last)
            passed = self.controller.pass_through(wanted[None])[0][0]
            led = ~running | self._away
            self.controller.hold(np.where(led, last, passed))
            ramped = self.controller.ramp(np.where(running, wanted, self._safe), self.rate)[0]
            command = np.where(led, ramped, passed)
            self.controller.hold(command)
            self._away = ~running | led & (command != wanted)
            rows.append(command)
        return np.array(rows), np.zeros_like(feedforward)


def _towards(target: float, value: float, step: float) -> float:
    """The value after a step towards a target."""
    return target if abs(target - value) <= step else value + math.copysign(step, target - value)
