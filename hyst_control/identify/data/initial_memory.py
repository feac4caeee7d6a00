# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Initial memory of a record: the turning points that a hysteresis remembers when the record begins.

A record may begin at rest on the initial loading curve, amid a motion, or in a periodic steady state. The memory is found from the record
itself, before any family is fitted: play operators with weights that change with the command are fitted to the record (a linear problem),
once for each of a few memories with which it may begin, and the memory with the smallest error is taken. Rows behind the first visit to
both extremes are the same for all of them, because those extremes wipe out what came before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numba import njit
from scipy.special import fdtri

from hyst_control.base.arrays import Array, Integers
from hyst_control.identify.data.fit import BeginningRow
from hyst_control.identify.data.fit_windows import closed_loop, memory_filled
from hyst_control.identify.data.reversal_points import turning_points
from hyst_control.identify.solve.bounded_least_squares import solve_bounded
from hyst_control.records.record import Beginning, Record
from hyst_control.records.stream.row_store import all_finite, blocks, total_variation

OPERATORS, ROWS, TURNS = 12, 2000, 9
"""Play operators of the fit; its rows before and behind the first visit to both extremes; further turning points that are tried."""
AT_ZERO = 0.01  # Share of the largest command up to which a record begins at 0 V
DOUBT = 1.1
"""Factor by which the square error may be larger than that of one on its initial loading curve, or of one preceded by itself."""
LIKELY = 0.95  # Quantile of the F distribution that this factor may reach where rows are few
ROWS_PER_WEIGHT = 4  # Least number of rows per weight
SURE = 4.0  # Factor by which every other memory has a larger square error where a record surely begins on its initial loading curve
LITTLE, HALF = 0.9, 0.5
"""Shares of the motion behind the first visit to both extremes, from which the rows before are left out without loss."""
HELD, MOST_LEVELS = 50, 20_000
"""Rows for which a command keeps a level that counts as held, and levels of a record beyond which none is looked for."""
LEG, LEG_ROWS = 0.05, (500, 2000)
"""Time (s) of a smooth way between two remembered turning points, and its least and largest number of rows."""

REST, FILLED = "at rest at 0 V, on the initial loading curve", "unknown: counted from where both extremes have been met"
PERIODIC, ESTIMATED = "periodic: preceded by itself", "with the memory of an earlier motion: turning points before it estimated"


@dataclass(frozen=True)
class Memory:
    """Memory of one axis."""

    turns: Annotated[Array, "M"]  # Turning points (M,), V, from the farthest one to the first command
    at_zero: bool = False  # Rest at 0 V
    loading: bool = False  # Surely brought from 0 V to the first command, on the initial loading curve
    periodic: bool = False  # The record itself precedes it


def with_beginning(data: Record) -> Record:
    """Find how a record begins, where its start is "auto"."""
    if data.start != "auto":
        return data
    if not (all_finite(data.command) and all_finite(data.measurement)):
        return replace(data, start="settled")  # who uses it refuses such a record, or shows it
    axes = range(data.command.shape[1])
    closed = closed_loop(data)
    memories = [estimated_memory(data.command[:, axis], data.measurement[:, axis], closed=closed) for axis in axes]
    if all(memory.at_zero for memory in memories):
        return replace(data, start=Beginning(REST, None, 0))
    filled = max(memory_filled(data.command[:, axis]) for axis in axes)
    remaining = min(share_of_motion(data.command[:, axis], filled) for axis in axes)
    if remaining < LITTLE and all(memory.periodic for memory in memories):
        beginning = Beginning(PERIODIC, data.command, 0)
    elif remaining >= HALF and not all(memory.loading or memory.at_zero for memory in memories):
        beginning = Beginning(FILLED, None, filled)
    else:
        beginning = Beginning(ESTIMATED, smooth_way([memory.turns for memory in memories], data), 0)
    return replace(data, start=beginning)


def beginning_rows(records: Sequence[Record]) -> list[BeginningRow]:
    """Describe how records begin, for the report."""
    rows: list[BeginningRow] = []
    for data in records:
        if data.start == "settled":
            rows.append({"name": data.name, "assumed": REST, "first_row": 0})
            continue
        known = data.start
        if not isinstance(known, Beginning):
            filled = max(memory_filled(data.command[:, axis]) for axis in range(data.command.shape[1]))
            closed = closed_loop(data)
            known = Beginning(PERIODIC if closed else FILLED, None, 0 if closed else filled)
        rows.append({"name": data.name, "assumed": known.assumed, "first_row": known.row})
    return rows


def begins_at_rest(data: Record) -> bool:
    """True where a record begins at rest at 0 V: its start says so, or its hysteresis does."""
    return data.start == "settled" or seems_at_rest(data)


def seems_at_rest(data: Record) -> bool:
    """True where the hysteresis of a record tells that it begins at rest; its dynamics may move all the same."""
    return isinstance(data.start, Beginning) and data.start.assumed == REST


def share_of_motion(command: Annotated[Array, "N"], row: int) -> float:
    """Share of a command's way that lies behind a row; 1 where it rests."""
    whole = total_variation(command)
    return total_variation(command, row) / whole if whole else 1.0


def estimated_memory(command: Annotated[Array, "N"], measurement: Annotated[Array, "N"], *, closed: bool = False) -> Memory:
    """Estimate the memory with which one axis of a record begins."""
    command, measurement = at_rest(command, measurement)
    first, low, high = float(command[0]), float(command.min()), float(command.max())
    at_zero = abs(first) <= AT_ZERO * max(abs(low), abs(high))
    from_zero = Memory(np.array([0.0, first]), at_zero=at_zero)
    if low == high:
        return from_zero if at_zero else Memory(np.array([first]), periodic=closed)
    inner = np.linspace(0.0, 1.0, TURNS + 2)[1:-1]
    candidates = [from_zero, *(Memory(np.array(turns)) for turns in ([high, low, first], [low, high, first]))]
    candidates += [Memory(np.array([high, low, first + share * (high - first), first])) for share in inner if high > first]
    candidates += [Memory(np.array([low, high, first + share * (low - first), first])) for share in inner if low < first]
    thresholds = 0.5 * (high - low) * (np.arange(OPERATORS) / OPERATORS) ** 1.4
    filled = memory_filled(command)
    early, late = spread_rows(0, filled), spread_rows(filled, len(command))
    # What follows the first visit to both extremes is the same for every memory.
    states = play_states(np.array([high, low, first]), thresholds, np.arange(3))[-1]
    after = followed(command, thresholds, states, late)
    rows = np.concatenate([early, late])
    trend = np.stack([np.ones(len(rows)), rows / max(len(command) - 1, 1) - 0.5], axis=1)
    target = measurement[rows]
    # A branch of a loop that falls where the command rises is none: few rows would otherwise be followed by any memory.
    sign = 1.0 if np.polyfit(command[rows], target, 1)[0] >= 0 else -1.0
    # Few rows, as of a staircase, tell no weights at both ends of the range.
    shares = ((command[rows] - low) / (high - low))[:, None]
    shares = np.array([1.0 - shares, shares]) if len(rows) >= ROWS_PER_WEIGHT * 2 * OPERATORS else np.ones((1, len(rows), 1))
    least = np.concatenate([np.zeros(len(shares) * OPERATORS), np.full(2, -np.inf)])
    freedom = max(len(rows) - len(least), 1)
    doubt = max(DOUBT, float(fdtri(freedom, freedom, LIKELY)))

    def error(memory: Memory) -> float:
        states = play_states(memory.turns, thresholds, np.array([len(memory.turns) - 1]))[-1]
        before = followed(command[: filled + 1], thresholds, states, early)
        operators = np.concatenate([before, after])
        slopes = sign * (operators - np.column_stack([operators[:, 1:], np.zeros(len(rows))]))
        columns = np.hstack([*(slopes * shares), trend])
        found = solve_bounded(columns.T @ columns, columns.T @ target, least, np.full(len(least), np.inf))
        return float(np.sum((target - columns @ found) ** 2))

    errors = [error(memory) for memory in candidates]
    best = int(np.argmin(errors))
    period = Memory(np.append(command[turning_points(command)], command[-1]), periodic=True)
    likely = min([*[period] * closed, from_zero], key=error)
    if error(likely) > doubt * errors[best]:
        return candidates[best]
    others = min(*errors[1:], error(period))
    return replace(likely, loading=likely is from_zero and SURE * errors[0] < others)


def spread_rows(begin: int, end: int) -> Integers:
    """At most `ROWS` rows from `begin` to `end` - 1, evenly spread."""
    return np.unique(np.linspace(begin, max(end - 1, begin), min(max(end - begin, 1), ROWS)).astype(np.int64))


def at_rest(command: Annotated[Array, "N"], measurement: Annotated[Array, "N"]) -> tuple[Array, Array]:
    """Command and measurement, a row each where a command of held levels stands: the mean of the second half, in which modes ring out."""
    moved = np.zeros(1, dtype=np.int64)
    for part in blocks(len(command) - 1):
        after = command[part.start + 1 : part.stop + 1] != command[part.start : part.stop]
        moved = np.append(moved, part.start + 1 + np.flatnonzero(after))
        if len(moved) > MOST_LEVELS:
            return command, measurement
    length = np.diff(moved, append=len(command))
    if np.sum(length[length >= HELD]) < 0.5 * len(command):
        return command, measurement
    half = moved + length // 2
    return command[moved], np.array([np.mean(measurement[a:b]) for a, b in zip(half, moved + length, strict=True)])


def play_states(turns: Array, thresholds: Array, rows: Integers) -> Array:
    """Outputs (R, n) of play operators of `thresholds` (n,) at some `rows` (R,) of a sequence of `turns` (M,), V, from rest at 0 V."""
    return followed(turns, thresholds, np.zeros(len(thresholds)), rows)


@njit(cache=True, error_model="numpy")
def followed(command: Annotated[Array, "N"], thresholds: Array, states: Array, rows: Integers) -> Annotated[Array, "R n"]:
    """Follow play operators along a command and keep some rows."""
    kept = np.empty((rows.size, thresholds.size))
    present = states.copy()
    index = 0
    for row in range(rows[-1] + 1 if rows.size else 0):
        u = command[row]
        for i in range(thresholds.size):
            present[i] = max(u - thresholds[i], min(u + thresholds[i], present[i]))
        if row == rows[index]:
            for i in range(thresholds.size):  # one by one: the check of a whole row's shape takes two seconds to compile
                kept[index, i] = present[i]
            index += 1
    return kept


def smooth_way(turns: Sequence[Array], data: Record) -> Annotated[Array, "R A"]:
    """Commands that lead through turning points to a record's first command, slow enough not to excite the dynamics."""
    rows = int(np.clip(LEG / data.sample_time, *LEG_ROWS))
    rise = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, rows + 1) / rows)
    most = max(len(each) for each in turns)
    columns = []
    for each in turns:
        points = np.concatenate([np.full(most - len(each), each[0]), each])
        legs = [points[i] + (points[i + 1] - points[i]) * rise for i in range(most - 1)]
        columns.append(np.concatenate([points[:1], *legs, np.full(rows, points[-1])]))
    return np.ascontiguousarray(np.stack(columns, axis=1))
