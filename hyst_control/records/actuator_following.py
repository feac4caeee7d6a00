# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Ticks at which an actuator does not follow its command, by what the plant says on `applied` meanwhile.

A stage that starts, or comes back from a fault, approaches its command at a safe rate. What is measured until it is met is no answer to
the recorded command.
"""

from __future__ import annotations

import math

import numpy as np

from hyst_control.base.arrays import Array, Integers, Mask

APPLIED = "applied"  # Topic on which the plant says what is on the actuator while that is not the command
INTERVAL = 0.005  # s, at least, between two messages there
LOST = 4  # Successive messages that may be lost while the actuator still does not follow
CLOSE = 1e-3  # Share of the command's range: a voltage that differs by less is the command, rounded by a converter


def ticks_not_followed(
    command: tuple[Array, Array], applied: tuple[Array, Array], step: float, close: Array | None = None
) -> list[range]:
    """Stretches of ticks at which the actuator does not follow its command."""
    # At a tick it has the command of that tick, or the one before where the loop is a tick late. A plant that always says what it applies
    # does not follow where it is neither of them.
    time, values = command
    said, voltages = applied
    newest = np.searchsorted(time, said + 0.5 * step) - 1
    said, voltages, newest = said[newest >= 0], voltages[newest >= 0], newest[newest >= 0]
    close = CLOSE * np.ptp(values, axis=0) if close is None else close
    differs = [(np.abs(voltages - values[np.maximum(newest - late, 0)]) > close).any(axis=1) for late in (0, 1)]
    ticks = np.rint(said[differs[0] & differs[1]] / step).astype(np.int64)
    if not len(ticks):
        return []
    interval = _interval(step)
    ends = np.flatnonzero(np.diff(ticks) > (LOST + 1) * interval)
    firsts, lasts = ticks[np.append(0, ends + 1)], ticks[np.append(ends, len(ticks) - 1)]
    return [range(first - 1, last + interval) for first, last in zip(firsts.tolist(), lasts.tolist(), strict=True)]


def _interval(step: float) -> int:
    """Ticks between two messages."""
    return max(1, math.ceil(INTERVAL / step - 1e-6))


class FollowingWatch:
    """Ticks of a running loop at which its actuator does not follow its command, found as the rows come."""

    def __init__(self, step: float, axes: int) -> None:
        self._step, self._axes, self._patience = step, axes, (LOST + 1) * _interval(step)
        self.forget()

    def forget(self) -> None:
        """Begin anew: the next rows may have any tick."""
        self._end = -math.inf  # tick from which on the actuator may follow again
        self._lower, self._upper = np.full(self._axes, np.inf), np.full(self._axes, -np.inf)
        self._time, self._values = np.zeros(0), np.zeros((0, self._axes))
        self._said, self._voltages = np.zeros(0, np.int64), np.zeros((0, self._axes))  # the two newest messages

    def look(self, command: tuple[Integers, Array], applied: tuple[Integers, Array]) -> tuple[Mask, Array]:
        """Find the ticks at which the actuator does not follow its command, and its voltage at every tick."""
        ticks, commands = command
        found: Mask = ticks < self._end
        if not len(ticks):
            return found, commands
        self._lower, self._upper = np.minimum(self._lower, commands.min(axis=0)), np.maximum(self._upper, commands.max(axis=0))
        time = np.append(self._time, self._step * ticks).astype(np.float64)
        values = np.concatenate([self._values, commands])
        self._time, self._values = time[-1:], values[-1:]
        if len(applied[0]):
            said = (self._step * applied[0]).astype(np.float64)
            for stretch in ticks_not_followed((time, values), (said, applied[1]), self._step, CLOSE * (self._upper - self._lower)):
                first = self._end if stretch.start - self._end <= self._patience else stretch.start
                found |= (first <= ticks) & (ticks < stretch.stop)
                self._end = stretch.stop
            self._said, self._voltages = np.append(self._said, applied[0]), np.concatenate([self._voltages, applied[1]])
        voltages = commands.copy()
        if found.any():
            voltages[found] = self._between(ticks[found], commands[found])
        self._said, self._voltages = self._said[-2:], self._voltages[-2:]
        return found, voltages

    def _between(self, ticks: Integers, commands: Array) -> Array:
        """Voltages (N, A) on straight lines between messages; after the last one the line goes on until it meets the command."""
        said, voltages = self._said, self._voltages
        found: Array = np.stack([np.interp(ticks, said, voltage) for voltage in voltages.T], axis=1)
        before = np.searchsorted(said, ticks, side="right") - 1
        for last in np.unique(before[before >= 0]):
            if last + 1 < len(said) and said[last + 1] - said[last] <= self._patience:
                continue
            onward = before == last
            known = last > 0 and said[last] - said[last - 1] <= self._patience
            slope = (voltages[last] - voltages[last - 1]) / (said[last] - said[last - 1]) if known else np.zeros(self._axes)
            line, wanted = voltages[last] + slope * (ticks[onward, None] - said[last]), commands[onward]
            met = np.logical_or.accumulate((line - wanted) * (voltages[last] - wanted[0]) <= 0.0, axis=0)
            found[onward] = np.where(met, wanted, line)
        return found
