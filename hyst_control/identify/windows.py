"""Which rows of the records a fit looks at: everything, or stretches of it while the structure is being chosen."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hyst_control.chain.stage import Array
from hyst_control.identify.dataset import Dataset
from hyst_control.identify.gram import Window

SETTLE_TIME = 0.25
"""Time (s) after which a window's linear transient is over, the slow pair's included; its rows before that do not count."""


def whole_records(datasets: Sequence[Dataset], axis: int) -> list[Window]:
    """Each record as one window. Where its start is unknown, rows count from where the memory is full."""
    windows = []
    for group, data in enumerate(datasets):
        command = np.ascontiguousarray(data.command[:, axis])
        skip = memory_filled(command) if data.start == "unknown" else 0
        windows.append(Window(command, np.ascontiguousarray(data.measurement[:, axis]), data.sample_time, data.hold, skip, group))
    return windows


def stretches(windows: Sequence[Window], rows: int, length: float = 1.0) -> list[Window]:
    """About `rows` rows in stretches of `length` s spread evenly over the records; the windows themselves if they have no more."""
    total = sum(len(window.command) for window in windows)
    if total <= rows:
        return list(windows)
    chosen = []
    for window in windows:
        n = len(window.command)
        size = min(int(length / window.sample_time), n)
        count = max(int(round(n * rows / total / size)), 1)
        if count * size >= n:
            chosen.append(window)
            continue
        turning = turning_points(window.command)
        for begin in np.unique(np.linspace(0, n - size, count + 1).astype(int)) if count > 1 else np.array([(n - size) // 2]):
            end = begin + size
            settle = 0 if begin == 0 else int(SETTLE_TIME / window.sample_time)
            skip = min(max(settle, window.skip - begin), size - 1)
            memory = window.command[turning[turning < begin]] if begin else None
            chosen.append(Window(window.command[begin:end], window.measurement[begin:end], window.sample_time, window.hold, skip,
                                 window.group, begin / n, size / n, memory))
    return chosen


def turning_points(command: Array) -> Array:
    """Indices of the samples at which a signal (N,) turns; play operators remember nothing else."""
    slope = np.sign(np.diff(command))
    moving = np.flatnonzero(slope)
    turns = moving[1:][slope[moving[1:]] != slope[moving[:-1]]]
    return np.concatenate([[0], turns]).astype(int)


def memory_filled(command: Array) -> int:
    """First row after which the command has met both its extremes: from there on earlier memory is wiped out."""
    span = np.ptp(command)
    high, low = np.flatnonzero(command >= command.max() - 0.01 * span), np.flatnonzero(command <= command.min() + 0.01 * span)
    return int(max(high[0], low[0]))
