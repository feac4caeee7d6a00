# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Watchdog between the command and the actuator: the last link, which needs nobody else to be alive.

Whoever drives an actuator puts every command through one. As long as commands are fresh they pass unchanged. Once the newest is too old,
because the feedback was killed or its messages do not arrive, or while two sources contradict each other, the actuator goes to the
watchdog's own safe value at its own rate. A command that comes back, or is the first one, is approached at that rate too and passes
unchanged from where it is met: a restarted feedback cannot make the actuator jump, whatever it believes of the command before.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array, Mask
from hyst_control.control.feedback.command_limits import MANY_AXES


class CommandWatchdog:
    """Watchdog that decides, tick by tick, which voltage the actuator gets."""

    def __init__(self, rest: Annotated[Array, "A"], safe: Annotated[Array, "A"], rate: float, period: float) -> None:
        self._rest, self._safe, self._step = np.array(rest, dtype=float), np.array(safe, dtype=float), rate * period
        self.reset()

    def reset(self) -> None:
        """Return to the start."""
        self.applied = self._rest.copy()  # Voltage on the actuator (A,), V: what was written last
        self._wanted = self.applied  # what `wanted` returned last
        self._met = np.zeros(len(self._rest), bool)  # axes whose commands pass unchanged
        self.armed = False  # True once there was a command: until then there is nothing to bring to safety
        self._below: Mask | None = None  # axes that were below the command that they approach

    @property
    def following(self) -> bool:
        """True while commands pass unchanged, and are written."""
        return self._wanted is self.applied and bool(self._met.all())

    def apply(self, command: Array | None, trusted: bool = True) -> Annotated[Array, "A"]:
        """Voltage of the next tick, where nothing can keep it from being written."""
        self.applied = self.wanted(command, trusted)
        return self.applied

    def wanted(self, command: Array | None, trusted: bool = True) -> Array:
        """Voltage (A,) to be written next, V, for the newest `command` (A,), if `trusted`; pass it to `written` once it is."""
        if self._wanted is not self.applied:  # it does not follow: it is to approach the command from where it is
            self._met[:], self._below = False, None
        self._wanted = self._next(command, trusted)
        return self._wanted

    def written(self, voltage: Array) -> None:
        """Take note that the `voltage` (A,), as `wanted` returned it, is on the actuator."""
        self.applied = voltage

    def _next(self, command: Array | None, trusted: bool) -> Array:
        if command is None or not trusted or not _is_finite(command):
            self._met[:], self._below = False, None
            return self._towards(self._safe) if self.armed else self.applied
        self.armed = True
        if not self._met.all():
            way = command - self.applied
            below = way > 0
            crossed = below != self._below if self._below is not None else False  # by no more than the command moves itself
            self._met |= (np.abs(way) <= self._step) | crossed
            self._below = below
            command = np.where(self._met, command, self._towards(command))
        return command

    def _towards(self, target: Array) -> Array:
        """A step from what is applied, which ends exactly at the target: a sum might pass it, and a limit, by its rounding."""
        step: Array = np.clip(target, self.applied - self._step, self.applied + self._step)
        return step


def _is_finite(command: Array) -> bool:
    """True where a command (A,) is finite on all axes; of few of them, a look at each is cheaper than one at the array."""
    return all(map(math.isfinite, command.tolist())) if len(command) <= MANY_AXES else bool(np.isfinite(command).all())
