# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Initial memory of a session: what a hysteresis still has of the time before the record.

Two play operators begun at either end of their play differ until the command has met both its extremes, by the wiping-out property of
hysteresis (Mayergoyz, Mathematical Models of Hysteresis, 1991). Such differences nearly span what an unknown memory adds. They are free in
every hypothesis beside baseline records; beside one of the same command the rows are left out in which that memory changes.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numba import njit

from hyst_control.base.arrays import Array
from hyst_control.diagnose.problem.per_record_stages import ErrorBasis, LearnedError
from hyst_control.diagnose.problem.problem import Problem

WIDTHS = (0.03, 0.08, 0.15, 0.25, 0.35, 0.45, 0.49)
"""Half widths of the operators, as shares of the command's span; an operator of half the span never moves."""
NEARLY = 0.05
"""Distance from an extreme, in shares of the span, at which it is nearly met: the rest of the memory is in few operators."""
SETTLES = 0.01  # Share of a record's rows for which what a change of the memory has set off may go on
LEAST = 1e-3  # Least size at the rows that count, in the largest one of all rows, of a direction that is kept


def initial_memory(problem: Problem, share: float) -> tuple[LearnedError, ...]:
    """Make the stage that adds what an unknown initial memory does, if that is anything."""
    if len(problem.model.axes) > 1:
        return ()
    directions = []
    for index, piece in enumerate(problem.pieces):
        command = np.ascontiguousarray(piece.command[:, 0])
        slope = float(np.ptp(piece.measurement)) / max(float(np.ptp(command)), 1e-300)
        columns = share * slope * left_of_memory(command, np.array(WIDTHS) * np.ptp(command))
        own = np.zeros((len(command), len(WIDTHS) * len(problem.pieces)))
        own[:, index * len(WIDTHS) : (index + 1) * len(WIDTHS)] = columns
        directions.append(own)
    counted = np.concatenate([piece.counted(own) for piece, own in zip(problem.pieces, directions, strict=True)])
    largest = max(float(np.max(np.abs(own), initial=0.0)) for own in directions)
    kept = np.flatnonzero(np.max(np.abs(counted), axis=0, initial=0.0) > LEAST * largest)
    return (LearnedError(np.zeros(len(kept)), ErrorBasis(tuple(own[:, kept] for own in directions))),) if len(kept) else ()


def wiped_out(command: Annotated[Array, "N A"]) -> int:
    """Find the row from which a record says next to nothing of the time before it: where its command has nearly met both extremes."""
    near = NEARLY * np.ptp(command, axis=0)
    met = np.argmax(command >= command.max(axis=0) - near, axis=0), np.argmax(command <= command.min(axis=0) + near, axis=0)
    return int(np.max(met))


def has_whole_loop(command: Annotated[Array, "N A"], first: int) -> bool:
    """Tell whether a command goes from one of its extremes to the other and back behind a row."""
    whole = (1.0 - 2.0 * NEARLY) * np.ptp(command, axis=0)
    rest = command[first:]
    back = rest[wiped_out(rest) :]
    return bool(np.all(np.ptp(rest, axis=0) >= whole) and np.all(np.ptp(back, axis=0) >= whole))


def is_new_ground(command: Annotated[Array, "N"]) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Find the rows in which a command goes beyond all that it has met since its beginning, and those shortly behind."""
    highest, lowest = np.maximum.accumulate(command), np.minimum.accumulate(command)
    beyond = np.concatenate([[True], (np.diff(highest) > 0.0) | (np.diff(lowest) < 0.0)])
    last = np.maximum.accumulate(np.where(beyond, np.arange(len(command)), 0))
    return np.asarray(np.arange(len(command)) - last <= SETTLES * len(command))


@njit(cache=True)
def left_of_memory(command: Annotated[Array, "N"], half_widths: Annotated[Array, "K"]) -> Annotated[Array, "N K"]:
    """Difference of two play operators that begin at either end of their play."""
    found = np.zeros((len(command), len(half_widths)))
    for k, half in enumerate(half_widths):
        upper, lower = command[0] + half, command[0] - half
        for row, u in enumerate(command):
            upper = min(max(upper, u - half), u + half)
            lower = min(max(lower, u - half), u + half)
            found[row, k] = upper - lower
    return found
