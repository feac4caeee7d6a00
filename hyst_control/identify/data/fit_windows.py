# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Rows of the records that a fit uses: all of them, or stretches while the structure is being chosen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.identify.data.record_segmentation import REST_TIME, resting_stretches, stretches_between_rests
from hyst_control.identify.data.reversal_points import turning_points
from hyst_control.identify.solve.gram_sums import Window
from hyst_control.records.quantization_step import rounding_weights
from hyst_control.records.record import Beginning, Record
from hyst_control.records.stream.row_store import column, empty_rows, first_row, total_variation

SETTLE_TIME = 0.25
"""Time (s) after which a window's linear transient is over, the slow pair's included; its rows before that do not count."""


def whole_records(records: Sequence[Record], axis: int, *, weighted: bool = True) -> list[Window]:
    """Take each record as one window; for a record of unknown start see `before`."""
    windows = []
    for group, data in enumerate(records):
        command = column(data.command, axis)
        memory, skip = before(data)
        windows.append(
            Window(
                command,
                column(data.measurement, axis),
                data.sample_time,
                data.hold,
                skip,
                group,
                memory=None if memory is None else column(memory, axis),
                weight=balanced_weights(data, axis) if weighted else None,
            )
        )
    return windows


def with_sign(window: Window, sign: float) -> Window:
    """Multiply the measurement of a window by 1 or -1."""
    if sign == 1.0:
        return window
    measurement = empty_rows(len(window.measurement))
    np.multiply(window.measurement, sign, out=measurement)
    return replace(window, measurement=measurement)


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
        turning = turning_points(window.command)
        for begin in np.unique(np.linspace(0, n - size, count + 1).astype(int)) if count > 1 else np.array([(n - size) // 2]):
            end = begin + size
            settle = 0 if begin == 0 else int(SETTLE_TIME / window.sample_time)
            skip = min(max(settle, window.skip - begin), size - 1)
            memory = window.command[turning[turning < begin]] if begin else None
            if window.memory is not None:
                earlier = window.memory[turning_points(window.memory)]
                memory = window.memory if memory is None else np.concatenate([earlier, memory])
            part = slice(begin, end)
            chosen.append(
                replace(
                    window,
                    command=window.command[part],
                    measurement=window.measurement[part],
                    skip=skip,
                    begin=begin / n,
                    share=size / n,
                    memory=memory,
                    weight=None if window.weight is None else window.weight[part],
                )
            )
    return chosen


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
