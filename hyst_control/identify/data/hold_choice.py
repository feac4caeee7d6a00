# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Hold of a record that states none: do its rows answer the command of the row before or their own (decided on held-out rows).

A DAC holds its command, so a sample cannot answer the command that is set at its own instant (`zoh`). Rows of pairs (voltage set,
position after settling) do, and so do samples of a smooth source (`foh`). Play operators with free weights tell, on rows held out, and
linear dynamics of a few poles with a direct path, where these leave less.
"""

from __future__ import annotations

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.identify.data.fit_windows import before
from hyst_control.identify.data.initial_memory import OPERATORS, followed, play_states, with_beginning
from hyst_control.identify.modal.vector_fitting import spread_poles, vector_fit
from hyst_control.identify.solve.gram_sums import Window
from hyst_control.records.record import Record

ROWS, MIN_ROWS, PARTS = 2**15, 64, 60
"""Rows of a record that are looked at, the least number of them, and parts of which every third is held out."""
POLES, LINEAR_ROWS = 6, 2**12
"""Poles of the linear dynamics, and rows from which they are taken."""
ROUNDING = 1e-9  # Of the range: errors below it are those of the arithmetic, and tell nothing
CLEAR = 0.7
"""Share of the error under `zoh` that must be left under `foh` for the latter to be taken."""


def hold_errors(data: Record) -> tuple[float, float]:
    """Held-out errors, shares of the range, with the command of the row before (`zoh`) and of the same row (`foh`); equal if untold."""
    memory, begin = before(with_beginning(data))
    end = min(begin + ROWS, len(data.command))
    if end - begin < MIN_ROWS:
        return 1.0, 1.0
    squares = np.zeros(2)
    for axis in range(data.command.shape[1]):
        command, measurement = data.command[:end, axis], data.measurement[begin:end, axis]
        low, high = float(data.command[:, axis].min()), float(data.command[:, axis].max())
        if low == high or not np.ptp(measurement) > 0.0 or not np.all(np.isfinite(measurement)):
            continue
        thresholds = 0.5 * (high - low) * (np.arange(OPERATORS) / OPERATORS) ** 1.4
        turns = np.zeros(1) if memory is None else memory[:, axis]
        first = play_states(turns, thresholds, np.array([len(turns) - 1]))[-1]
        states = np.vstack([first, followed(command, thresholds, first, np.arange(end))])
        plays = [_held_out(states[begin:end], measurement), _held_out(states[begin + 1 : end + 1], measurement)]
        squares += np.minimum(plays, [_left_by_poles(data, axis, begin, hold) for hold in ("zoh", "foh")])
    late, same = np.sqrt(squares)
    return float(late), float(same)


def _left_by_poles(data: Record, axis: int, begin: int, hold: str) -> float:
    """Mean square error (share of the range) that linear dynamics leave of the first rows that count, corrected for their number."""
    rows = slice(begin, min(begin + LINEAR_ROWS, len(data.command)))
    command, measurement = data.command[rows, axis], data.measurement[rows, axis]
    if not np.ptp(command) > 0.0 or len(command) < 8 * POLES or not np.ptp(measurement) > 0.0:
        return np.inf
    window = Window(command, measurement, data.sample_time, hold, 0, 0)
    found = vector_fit([window], spread_poles(POLES, len(command)), 0.0, True, relocations=4)
    return float(found.error / (1.0 - 4.0 * POLES / len(command)) / np.ptp(measurement) ** 2)


def _held_out(states: Array, measurement: Array) -> float:
    """Mean square error (share of the range) on every third part of the rows, of a fit to the others."""
    rows = np.arange(len(measurement))
    columns = np.column_stack([states, np.ones(len(rows)), rows / len(rows)])
    held = rows * PARTS // len(rows) % 3 == 2
    weights = np.linalg.lstsq(columns[~held], measurement[~held], rcond=1e-9)[0]
    return float(np.mean((measurement[held] - columns[held] @ weights) ** 2) / np.ptp(measurement) ** 2)
