# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Hold of a record that states none: do its rows answer the command of the row before or their own (decided on held-out rows).

A DAC holds its command, so a sample cannot answer the command that is set at its own instant (`zoh`). Rows of pairs (voltage set,
position after settling) do, and so do samples of a smooth source (`foh`). Play operators with free weights tell, on rows held out, and
linear dynamics of a few poles with a direct path, where these leave less.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.identify.data.fit_windows import before
from hyst_control.identify.data.initial_memory import OPERATORS, followed, play_states, with_beginning
from hyst_control.records.record import Record
from hyst_control.records.validity.incoherence import next_sample_correlation
from hyst_control.records.validity.reference_model import linear_reference
from hyst_control.records.validity.rows import fastest_rows

ROWS, MIN_ROWS, PARTS = 2**15, 64, 60
"""Rows of a record that are looked at, the least number of them, and parts of which every third is held out."""
PAIRS, LINEAR_ROWS, ROWS_OF_A_PAIR = (1, 2, 4, 6), 2**12, 16
"""Pairs of poles of the linear dynamics, rows to which they are fitted (where an axis' command moves fastest), and fewest for each pair."""
LATEST = 3
"""Largest number of rows by which a measurement may answer late, so that the few poles need not imitate a delay."""
ROUNDING = 1e-9  # Of the range: errors below it are those of the arithmetic, and tell nothing
CLEAR, CLEAR_AT_NOISE = 0.7, 0.95
"""Share of the error under `zoh` that must be left under `foh` for the latter to be taken; and where nothing but white noise is left."""
WHITE = 0.1  # Correlation of neighbors up to which an error is white


class HoldErrors(NamedTuple):
    """Held-out errors, shares of the range, with the command of the row before (`zoh`) and of the same row (`foh`); equal if untold."""

    late: float
    same: float
    noise: bool = False  # Nothing but white noise is left with the command of the same row

    @property
    def own_row(self) -> bool:
        """True where the measurement answers the command of its own row."""
        return self.late >= ROUNDING and self.same < (CLEAR_AT_NOISE if self.noise else CLEAR) * self.late


def hold_errors(data: Record) -> HoldErrors:
    """Errors that play operators or linear dynamics, whichever leave less, make of a record with either hold."""
    memory, begin = before(with_beginning(data))
    end = min(begin + ROWS, len(data.command))
    moving = [axis for axis in range(data.command.shape[1]) if np.ptp(data.command[:, axis]) > 0.0]
    if end - begin < MIN_ROWS or not moving:
        return HoldErrors(1.0, 1.0)
    states = np.hstack([_play_states(data, memory, axis, end) for axis in moving])
    squares, noise = np.zeros(2), True
    for axis in moving:
        measurement = data.measurement[begin:end, axis]
        if not np.ptp(measurement) > 0.0 or not np.all(np.isfinite(measurement)):
            continue
        plays = [_held_out(states[begin:end], measurement), _held_out(states[begin + 1 : end + 1], measurement)]
        rows = fastest_rows(data.command[begin:end, [axis]], min(LINEAR_ROWS, end - begin))
        poles, white = _left_by_poles(data.command[begin:end, moving][rows], measurement[rows])
        squares += np.minimum(plays, poles)
        noise &= white and poles[1] < plays[1]
    late, same = np.sqrt(squares)
    return HoldErrors(float(late), float(same), noise)


def _play_states(data: Record, memory: Array | None, axis: int, end: int) -> Array:
    """States of play operators before and behind each of the first rows of a command."""
    command = data.command[:, axis]
    thresholds = 0.5 * float(np.ptp(command)) * (np.arange(OPERATORS) / OPERATORS) ** 1.4
    turns = np.zeros(1) if memory is None else memory[:, axis]
    first = play_states(turns, thresholds, np.array([len(turns) - 1]))[-1]
    return np.vstack([first, followed(command[:end], thresholds, first, np.arange(end))])


def _left_by_poles(command: Array, measurement: Array) -> tuple[Array, bool]:
    """Held-out mean square errors, shares of the range, of linear dynamics from the commands (N, A) of rows before and of the same.

    With enough poles either command explains a record to its noise, so Schwarz's criterion puts a price on each parameter. The second value
    is true where the commands of the same row leave nothing but white noise.
    """
    measurement = measurement[LATEST:]
    count, axes = len(measurement), command.shape[1]
    found, white = np.full(2, np.inf), False
    if not np.ptp(measurement) > 0.0:
        return found, white
    for late in range(LATEST, -1, -1):
        way = 0 if late else 1
        for pairs in (each for each in PAIRS if count >= ROWS_OF_A_PAIR * each):
            fit = linear_reference(command[LATEST - late : len(command) - late], measurement, pairs)
            error = fit.unexplained * count ** ((axes * (2 * pairs + 1) + 2 * pairs) / count)
            if error < found[way]:
                found[way], white = error, abs(next_sample_correlation(measurement - fit.predicted)) < WHITE
    return found * np.var(measurement) / np.ptp(measurement) ** 2, white


def _held_out(states: Array, measurement: Array) -> float:
    """Mean square error (share of the range) on every third part of the rows, of a fit to the others."""
    rows = np.arange(len(measurement))
    columns = np.column_stack([states, np.ones(len(rows)), rows / len(rows)])
    held = rows * PARTS // len(rows) % 3 == 2
    weights = np.linalg.lstsq(columns[~held], measurement[~held], rcond=1e-9)[0]
    return float(np.mean((measurement[held] - columns[held] @ weights) ** 2) / np.ptp(measurement) ** 2)
