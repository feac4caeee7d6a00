"""Ticks at which an actuator does not follow its command, by what the plant says on `applied` meanwhile.

A stage that starts, or comes back from a fault, approaches its command at a safe rate. What is measured until it is met is no answer to
the recorded command.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

APPLIED = "applied"
"""Topic on which the plant says what is on the actuator while that is not the command."""

INTERVAL = 0.005
"""s, at least, between two messages there."""

LOST = 4
"""Successive messages that may be lost while the actuator still does not follow."""

CLOSE = 1e-3
"""Share of the command's range: a voltage that differs by less is the command, rounded by a converter."""


def ticks_not_followed(command: tuple[Array, Array], applied: tuple[Array, Array], step: float) -> list[range]:
    """Stretches of ticks at which the actuator does not follow its command.

    At a tick it has the command of that tick, or the one before where the loop is a tick late. A plant that always says what it applies
    does not follow where it is neither of them.

    Parameters
    ----------
    command
        Sample times (N,), s, and values (N, A), V.
    applied
        The same (M,), (M, A) of what is on the actuator.
    step
        Sample time of the command, s.

    Returns
    -------
    list[range]
        Ticks round(t / step), in order: from the first command that was not applied to where the next message would be due.
    """
    time, values = command
    said, voltages = applied
    newest = np.searchsorted(time, said + 0.5 * step) - 1
    said, voltages, newest = said[newest >= 0], voltages[newest >= 0], newest[newest >= 0]
    if not len(said):
        return []
    close = CLOSE * np.ptp(values, axis=0)
    differs = [(np.abs(voltages - values[np.maximum(newest - late, 0)]) > close).any(axis=1) for late in (0, 1)]
    ticks = np.rint(said[differs[0] & differs[1]] / step).astype(np.int64)
    if not len(ticks):
        return []
    interval = max(1, math.ceil(INTERVAL / step - 1e-6))
    ends = np.flatnonzero(np.diff(ticks) > (LOST + 1) * interval)
    firsts, lasts = ticks[np.append(0, ends + 1)], ticks[np.append(ends, len(ticks) - 1)]
    return [range(first - 1, last + interval) for first, last in zip(firsts.tolist(), lasts.tolist(), strict=True)]
