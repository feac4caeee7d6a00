# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Records of the same command: baseline ones that match a new one up to a shift, and the periods of a periodic command."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.signals import correlated
from hyst_control.diagnose.configuration import BaselineSettings
from hyst_control.diagnose.problem.problem import Piece, Problem
from hyst_control.records.repeated_periods import is_same, period_of
from hyst_control.records.session_zero import SHAPES, without_zero


@dataclass(frozen=True)
class Match:
    """Baseline record with the same command: row k of the new record matches row k + shift of the baseline one, for begin ≤ k < end."""

    clean: Piece
    shift: int
    begin: int
    end: int


def matching(command: Annotated[Array, "N A"], clean: Sequence[Piece], same: float, overlap: float) -> list[Match]:
    """Find the baseline records that have the same command up to a shift."""
    found = []
    for piece in clean:
        other = piece.command
        if len(other) >= len(command) and is_same(command, other[: len(command)], same):
            shift = 0
        else:
            shift = _shift(command, other, int(np.ceil(overlap * len(command))))
        begin, end = max(0, -shift), min(len(command), len(other) - shift)
        if end - begin >= overlap * len(command) and is_same(command[begin:end], other[begin + shift : end + shift], same):
            found.append(Match(piece, shift, begin, end))
    return found


def _shift(command: Array, other: Array, least: int) -> int:
    """Shift with the least mean square difference between two commands; the overlap has at least `least` rows."""
    rows, shifts = len(command), np.arange(-(len(command) - 1), len(other))
    begin, end = np.maximum(0, -shifts), np.minimum(rows, len(other) - shifts)
    squares = [np.concatenate([[0.0], np.cumsum(np.sum(values**2, axis=1))]) for values in (command, other)]
    products = np.sum([correlated(other[:, axis], command[:, axis]) for axis in range(command.shape[1])], axis=0)
    energy = squares[0][end] - squares[0][begin] + squares[1][end + shifts] - squares[1][begin + shifts]
    difference = (energy - 2.0 * products) / np.maximum(end - begin, 1)
    return int(shifts[np.argmin(np.where(end - begin >= least, difference, np.inf))])


def as_clean_command(problem: Problem, clean: Problem, settings: BaselineSettings) -> Problem:
    """Put the command of a baseline record in the place of one whose roughness the plant did not receive, where both are the same."""
    pieces = []
    for piece in problem.pieces:
        if piece.recorded is not None:
            rough = float(np.sqrt(np.mean((piece.recorded - piece.command) ** 2))) / float(np.ptp(piece.command))
            same = min(max(settings.same_command, rough), settings.similar_command)
            found = matching(piece.command, clean.pieces, same, settings.overlap)
            if found:
                command, match = piece.command.copy(), found[0]
                rows = slice(match.begin, match.end)
                command[rows] = match.clean.command[match.begin + match.shift : match.end + match.shift]
                piece = replace(piece, command=command)
        pieces.append(piece)
    return replace(problem, pieces=tuple(pieces))


def repeating_rows(command: Annotated[Array, "N A"], begin: int, end: int, settings: BaselineSettings) -> slice:
    """Rows of a baseline record that tell what its periods differ by."""
    # A single period is taken with the one before it in the warm-up, in which memory and simulation may still settle.
    if period_of(command[begin:end], settings.same_command) is None:
        period = period_of(command[:end], settings.same_command)
        if period is not None and period <= min(begin, end - begin):
            return slice(begin - period, end)
    return slice(begin, end)


def period_differences(
    command: Annotated[Array, "N A"], error: Annotated[Array, "N A"], before: int, settings: BaselineSettings
) -> tuple[list[Array], list[Array]]:
    """The part of an error that does not repeat from period to period of a periodic command."""
    whole = _whole_periods(command, error, before, settings)
    if not len(whole):
        return [], []
    # Zero, drift and curvature take a good deal off a short period.
    longer = np.sqrt(whole.shape[1] / max(whole.shape[1] - len(SHAPES), 1))
    about_mean = (whole - whole.mean(axis=0)) / np.sqrt(1.0 - 1.0 / len(whole))
    return (
        [longer * without_zero(later - earlier)[0] for earlier, later in zip(whole[:-1], whole[1:], strict=True)],
        [without_zero(about_mean.reshape(-1, error.shape[1]))[0]],
    )


def _whole_periods(command: Array, error: Array, before: int, settings: BaselineSettings) -> Array:
    """The error's whole periods (n, P, A); none if the command (N, A) is not periodic."""
    period = period_of(command, settings.same_command)
    if period is None:
        return np.empty((0, 0, error.shape[1]))
    if len(command) >= 3 * period and before < period:  # what is left of the memory fills in the first one
        error = error[period:]
    count = len(error) // period
    return error[: count * period].reshape(count, period, -1)
