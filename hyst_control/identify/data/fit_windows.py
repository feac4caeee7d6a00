# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Rows of the records that a fit uses: all of them, or stretches while the structure is being chosen."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.identify.data.record_segmentation import REST_TIME, resting_stretches, stretches_between_rests
from hyst_control.identify.data.reversal_points import surviving_turns, turning_points
from hyst_control.identify.solve.gram_sums import Window
from hyst_control.records.quantization_step import rounding_weights
from hyst_control.records.record import Beginning, Record
from hyst_control.records.stream.row_store import blocks, column, empty_rows, first_row, total_variation

SETTLE_TIME = 0.25
"""Time (s) after which a window's linear transient is over, the slow pair's included; its rows before that do not count."""
FEW_ROWS, STILL = 16, 0.03
"""Rows that are thinned no further for the sign of a response, and share of the liveliest changes below which the command is still."""


def whole_records(records: Sequence[Record], axis: int, *, weighted: bool = True) -> list[Window]:
    """Take each record as one window; for a record of unknown start see `before`."""
    windows = []
    for group, data in enumerate(records):
        memory, skip = before(data)
        windows.append(
            replace(
                as_window(data, axis, group),
                skip=skip,
                memory=None if memory is None else column(memory, axis),
                weight=balanced_weights(data, axis) if weighted else None,
            )
        )
    return windows


def as_window(data: Record, axis: int, group: int) -> Window:
    """A record from its first row, without memory."""
    return Window(column(data.command, axis), column(data.measurement, axis), data.sample_time, data.hold, 0, group)


def with_sign(window: Window, sign: float) -> Window:
    """Multiply the measurement of a window by 1 or -1."""
    if sign == 1.0:
        return window
    measurement = empty_rows(len(window.measurement))
    np.multiply(window.measurement, sign, out=measurement)
    return replace(window, measurement=measurement)


def response_sign(windows: Sequence[Window]) -> float:
    """Sign of the slow response: 1 where the measurement rises with the command, else -1.

    What is faster than a mode or the delay may be answered with either sign. So the windows are thinned to half their rows again and
    again, and the changes between neighbors compared, at the coarsest at which the command still moves.
    """
    moved: list[tuple[float, float]] = []
    while windows:
        square = covariance = 0.0
        for window in windows:
            for part in blocks(len(window.command)):
                rows = slice(part.start, part.stop + 1)
                change = np.diff(window.command[rows])
                square += window.sample_time * float(change @ change)
                covariance += window.sample_time * float(change @ np.diff(window.measurement[rows]))
        moved.append((square, covariance))
        due = 1.5 * min(window.sample_time for window in windows)
        few = [window for window in windows if window.sample_time > due or len(window.command) > FEW_ROWS]
        windows = [window if window.sample_time > due else _halved(window) for window in few]
    most = max(square for square, _ in moved)
    return -1.0 if [covariance for square, covariance in moved if square >= STILL * most][-1] < 0 else 1.0


def _halved(window: Window) -> Window:
    """A window of half as many rows, smoothed by binomial weights, which keep its faster motions out better than means of two."""
    size = len(window.command) // 2 - 1
    halves = []
    for values in (window.command, window.measurement):
        half = empty_rows(size)
        for part in blocks(size):
            rows = values[2 * part.start : 2 * part.stop + 2]
            half[part] = (rows[:-2:2] + 3.0 * rows[1:-1:2] + 3.0 * rows[2::2] + rows[3::2]) / 8.0
        halves.append(half)
    return replace(window, command=halves[0], measurement=halves[1], sample_time=2.0 * window.sample_time)


def turned_over(data: Record) -> Record:
    """The record with its measurement multiplied by -1."""
    measurement = empty_rows(*data.measurement.shape)
    np.negative(data.measurement, out=measurement)
    return data.with_values(measurement=measurement)


def balanced_weights(data: Record, axis: int) -> Array | None:
    """Weight rows so that slow and fast motions between rests count alike and short fast loops are not drowned.

    Readings that repeat because they are rounded count as one (`rounding_weights`).
    """
    motions = [stretch for stretch in stretches_between_rests(data, 0, axis) if stretch.kind == "motion"]
    rounded = rounding_weights(data.command[:, axis], data.measurement[:, axis])
    if len(motions) < 2:
        return rounded
    weight = empty_rows(len(data.command))
    weight[:] = 1.0 if rounded is None else rounded
    mean = np.mean([stretch.end - stretch.begin for stretch in motions])
    for stretch in motions:
        weight[stretch.begin : stretch.end] *= np.clip(mean / (stretch.end - stretch.begin), 0.2, 5.0)
    weight /= weight.mean()
    return weight


def before(data: Record) -> tuple[Array | None, int]:
    """Find the commands that precede a record, and its first row that counts.

    A record of unknown start that is a closed loop (it ends where it began) is taken to have been preceded by itself. Any other
    counts from where its command has met both its extremes, which wipes out all earlier memory.
    """
    if isinstance(data.start, Beginning):
        return data.start.memory, data.start.row
    if data.start != "unknown":
        return None, 0
    if closed_loop(data):
        return data.command, 0
    return None, max(memory_filled(data.command[:, axis]) for axis in range(data.command.shape[1]))


def closed_loop(data: Record) -> bool:
    """Report whether a record ends where it began, command and measurement alike."""
    gap = np.abs(np.stack([data.command[-1] - data.command[0], data.measurement[-1] - data.measurement[0]]))
    span = np.stack([np.ptp(data.command, axis=0), np.ptp(data.measurement, axis=0)])
    return bool(np.all(gap < 0.03 * span))


def cut(window: Window, begins: Iterable[int], size: int, settle: float) -> list[Window]:
    """Stretches of `size` rows of a window, with the turning points before them that still matter.

    Their beginning, up to the time `settle` (s), does not count: a linear transient is over by then.
    """
    n, turns = len(window.command), turning_points(window.command)
    before_it = np.zeros(1) if window.memory is None else window.memory[turning_points(window.memory)]
    found = []
    for begin in begins:
        rows = slice(begin, begin + size)
        earlier = np.concatenate([before_it, window.command[turns[turns < begin]]])
        found.append(
            replace(
                window,
                command=window.command[rows],
                measurement=window.measurement[rows],
                skip=min(max(int(settle / window.sample_time) if begin else 0, window.skip - begin), size - 1),
                begin=window.begin + window.share * begin / n,
                share=window.share * size / n,
                memory=earlier[surviving_turns(earlier)] if begin else window.memory,
                weight=None if window.weight is None else window.weight[rows],
            )
        )
    return found


def stretches(windows: Sequence[Window], rows: int, length: float = 1.0) -> list[Window]:
    """Choose short stretches that are spread evenly over the records."""
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
        begins = np.unique(np.linspace(0, n - size, count + 1).astype(int)) if count > 1 else [(n - size) // 2]
        chosen += cut(window, begins, size, SETTLE_TIME)
    return chosen


def short_stretches(windows: Sequence[Window], rows: int, length: float, settle: float) -> list[Window]:
    """Choose the fastest stretches, and at least three more of every window; creeping records stay whole, but coarser (`thinned`).

    A sweep passes each mode in a few rows, which even stretches would miss: half of the rows are those whose command moves fastest.
    """
    if sum(len(window.command) for window in windows) <= rows:
        return list(windows)
    whole = [(window, thinned(window)) for window in windows]
    chosen = [thin for window, thin in whole if thin is not window]
    quick = [window for window, thin in whole if thin is window]
    total = sum(len(window.command) for window in quick)
    left = max(rows - sum(len(window.command) for window in chosen), total // 50) // 2
    speeds = [_speeds(window, length) for window in quick]
    cells = [(speed, len(window.command) / len(own)) for window, own in zip(quick, speeds, strict=True) for speed in own]
    cells.sort(reverse=True)
    beyond = np.flatnonzero(np.cumsum([size for _, size in cells]) > left)
    limit = cells[beyond[0]][0] if len(beyond) else 0.0
    for window, own in zip(quick, speeds, strict=True):
        used = own > limit
        used[np.linspace(0, len(own) - 1, max(round(len(own) * left / total), 3)).astype(int)] = True
        edges = np.linspace(0, len(window.command), len(own) + 1).astype(int)
        for first, last in np.flatnonzero(np.diff(used, prepend=False, append=False)).reshape(-1, 2):
            chosen += cut(window, [edges[first]], edges[last] - edges[first], settle)
    return chosen


def _speeds(window: Window, length: float) -> Array:
    """Mean square speed (n,) of the command in each of the equal parts of about a length (s)."""
    count = max(int(len(window.command) * window.sample_time / length), 1)
    edges = np.linspace(0, len(window.command), count + 1).astype(int)
    return np.array([np.mean(np.square(np.diff(window.command[a : b + 1]))) for a, b in pairwise(edges)]) / window.sample_time**2


def thinned(window: Window) -> Window:
    """Thin a window whose command creeps to every n-th row, between which its motion is straight.

    A held command is, at the coarse sample time, the mean of the values before and after the tick.
    """
    steps = np.abs(np.diff(window.command))
    largest = float(steps.max()) if len(steps) else 0.0
    factor = int(0.01 * float(np.ptp(window.command)) / largest) if largest > 0 else 1
    if factor < 4 or window.memory is not None:
        return window
    command = window.command
    if window.hold == "zoh":
        command = 0.5 * (np.append(command[:1], command[:-1]) + command)
    return replace(
        window,
        command=np.ascontiguousarray(command[::factor]),
        measurement=np.ascontiguousarray(window.measurement[::factor]),
        sample_time=window.sample_time * factor,
        hold="foh",
        skip=-(-window.skip // factor),
    )


def virgin_rows(command: Array) -> int:
    """Rows (N,) of a command before it has met both its ends: there an actuator is on its initial loading curve, if it was at rest before.

    0 where less than half of the motion would be left.
    """
    first = memory_filled(command)
    return first if total_variation(command, first) > 0.5 * total_variation(command) else 0


def first_motion(command: Array) -> int:
    """The first row of a command (N,) that differs from the one before; N where it rests."""
    return min(first_row(len(command), lambda part: np.diff(command[part.start : part.stop + 1]) != 0) + 1, len(command))


def memory_filled(command: Annotated[Array, "N"]) -> int:
    """Find the row after which the command has met both its extremes, so that earlier memory is wiped out."""
    lowest, highest = float(command.min()), float(command.max())
    near = 0.01 * (highest - lowest)
    return max(
        first_row(len(command), lambda part: command[part] >= highest - near),
        first_row(len(command), lambda part: command[part] <= lowest + near),
    )


def largest_drift(data: Record, axis: int) -> float:
    """Bound the drift over a record by its rests at one command.

    A drift shows at rest as in motion. What changes with the motions alone, as the mean of a loop does with its frequency, must not
    be taken for a drift: otherwise records whose frequency rises with time would teach the model the wrong mean.
    """
    command, measurement = data.command[:, axis], data.measurement[:, axis]
    filled = memory_filled(command)
    rests = [
        (begin, end) for begin, end in resting_stretches(command, int(max(REST_TIME / data.sample_time, 2))) if begin >= filled
    ]
    span, largest = float(np.ptp(command)), np.inf
    for level in {round(float(command[end - 1]) / span, 4) for _, end in rests} if span else ():
        equal = [(begin, end) for begin, end in rests if abs(command[end - 1] / span - level) < 2e-4]
        # The later half of a rest: the transient of the motion before it has decayed by then.
        values = [float(np.mean(measurement[(begin + end) // 2 : end])) for begin, end in equal]
        apart = 0.75 * (equal[-1][1] - equal[0][1]) + 0.25 * (equal[-1][0] - equal[0][0])
        if apart > 0.5 * len(command):
            largest = min(largest, float(np.ptp(values)) * len(command) / apart)
    return largest
