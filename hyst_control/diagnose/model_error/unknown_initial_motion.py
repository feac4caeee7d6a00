# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Motion of the dynamics that goes on from before a record, such as the ringing of a mode in a part cut out of a longer run.

Where the nominal dynamics ringing freely explain most of what differs, their states are free in every hypothesis. Baseline records may
begin amid a motion as well. Those of the same command carry it over with all else that the model lacks, and the states are those of the
difference. Beside others it is subtracted from all records before: a state that is fitted to one record with an effect takes a part of it.
The first rows of such a record, as many as the delay has, respond to commands from before the record and are skipped. If the free motion
decays within a tenth of the record, all rows until then are skipped: the initial state of an effect under test is unknown, too.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.chain.linear.linear_filter import LinearFilter
from hyst_control.chain.linear.linear_stages import Delay
from hyst_control.diagnose.configuration import BaselineSettings
from hyst_control.diagnose.model_error.same_command import matching
from hyst_control.diagnose.problem.per_record_stages import ErrorBasis, LearnedError
from hyst_control.diagnose.problem.problem import Piece, Problem
from hyst_control.identify.assess.free_motion import ROWS, ending_dynamics, free_motion, moves_already, states_of

DIED_AWAY = 1e-3  # Share of a motion that is left where it has died away
MAX_SKIPPED = 0.1  # Maximum share of a record's rows that are skipped
EARLY_ERROR = 8.0  # Standard deviations of later errors: early error from which a record does not begin at rest
SMALLEST = 1e-6  # Size of a direction, in that of the largest one, under which it is left out


def beside_clean(problem: Problem, clean: Problem, settings: BaselineSettings) -> tuple[Problem, Problem]:
    """Both problems with the motions that their records begin amid as something known, or as a session effect."""
    if all(_begin_together(piece, clean, settings) for piece in problem.pieces):
        return with_initial_motion(problem, without_initial_motion(clean) is not clean), clean
    return without_initial_motion(without_first_rows(problem)), without_initial_motion(without_first_rows(clean))


def _begin_together(piece: Piece, clean: Problem, settings: BaselineSettings) -> bool:
    """True where a baseline record has the same command from the first row on."""
    found = matching(piece.command, clean.pieces, settings.same_command, settings.overlap)
    return any(match.shift == 0 for match in found)


def without_first_rows(problem: Problem) -> Problem:
    """Skip the first rows of records that do not begin at rest: those that respond to commands from before the record."""
    dynamics = ending_dynamics(problem.model, problem.sample_time, problem.hold)
    if dynamics is None:
        return problem
    delays = [float(np.max(stage.tau)) for stage in problem.model.chain.stages if isinstance(stage, Delay)]
    late = int(np.ceil(sum(delays) / problem.sample_time - SMALLEST))
    slowest = float(np.max(np.abs(np.linalg.eigvals(dynamics.a))))
    still = late + np.log(DIED_AWAY) / np.log(slowest) if 0.0 < slowest < 1.0 else np.inf
    pieces = []
    for piece, error in zip(problem.pieces, _errors(problem), strict=True):
        if skipped := _rows_before_rest(dynamics, piece, error, late, still):
            piece = replace(piece, keep=piece.mask & (np.arange(len(piece.command)) >= piece.first + skipped))
        pieces.append(piece)
    return problem if all(a is b for a, b in zip(pieces, problem.pieces, strict=True)) else replace(problem, pieces=tuple(pieces))


def with_initial_motion(problem: Problem, everywhere: bool = False) -> Problem:
    """The problem with the free motion of each record that begins amid one, or of every record, as a session effect."""
    dynamics = ending_dynamics(problem.model, problem.sample_time, problem.hold)
    if dynamics is None:
        return problem
    columns = [
        _directions(dynamics, piece, None if everywhere else error)
        for piece, error in zip(problem.pieces, _errors(problem), strict=True)
    ]
    count = sum(each.shape[2] for each in columns)
    if not count:
        return problem
    directions, at = [], 0
    for own in columns:
        whole = np.zeros((*own.shape[:2], count))
        whole[:, :, at : at + own.shape[2]] = own
        at += own.shape[2]
        directions.append(whole)
    stage = LearnedError(np.zeros(count), ErrorBasis(tuple(directions)))
    return replace(problem, model=problem.model.with_stages([*problem.model.chain.stages, stage]))


def without_initial_motion(problem: Problem) -> Problem:
    """The problem with measurements without the free motion of each record that begins amid one."""
    dynamics = ending_dynamics(problem.model, problem.sample_time, problem.hold)
    if dynamics is None:
        return problem
    pieces = []
    for piece, error in zip(problem.pieces, _errors(problem), strict=True):
        states = _states(dynamics, piece, error)
        if states is not None:
            moved = np.einsum("ina,ia->na", _motion(dynamics, piece), states)
            piece = replace(piece, measurement=piece.measurement - moved, read=piece.readings)
        pieces.append(piece)
    return problem if all(a is b for a, b in zip(pieces, problem.pieces, strict=True)) else replace(problem, pieces=tuple(pieces))


def _rows_before_rest(dynamics: LinearFilter, piece: Piece, error: Array, late: int, still: float) -> int:
    """Number of first rows to skip; late: rows of the delay, still: rows until the free motion has decayed."""
    dies = still <= MAX_SKIPPED * len(error)
    if dies:
        moved = np.abs(np.diff(piece.command[piece.first :], axis=0)).sum(axis=1)
        dies = moved[int(still) :].sum() >= (1.0 - 2.0 * MAX_SKIPPED) * moved.sum()
    if dies:  # also where an effect hides the free motion of the nominal dynamics
        first, rest = error[: int(still)], error[int(still) :]
        if np.any(np.abs(first - rest.mean(axis=0)).max(axis=0) > EARLY_ERROR * rest.std(axis=0)):
            return int(still)
    return late if late < len(error) and _states(dynamics, piece, error) is not None else 0


def _errors(problem: Problem) -> list[Array]:
    """Errors of the nominal model in each record's rows that count, measurement unit."""
    left = problem.by_piece(problem.in_noise(problem.measured() - problem.simulate(problem.model.chain.stages)))
    return [error * problem.sigma for error in left]


def _states(dynamics: LinearFilter, piece: Piece, error: Array) -> Array | None:
    """States (n, A) with which a record begins; None where it begins at rest."""
    known = piece.mask[piece.first : piece.first + ROWS]
    early = free_motion(dynamics, len(known))[:, known]
    rows, coupled = error[: early.shape[1]], len(dynamics.a) == 1
    if not np.isfinite(rows).all() or not moves_already(early, rows, coupled):
        return None
    return states_of(early, rows, coupled)


def _motion(dynamics: LinearFilter, piece: Piece) -> Array:
    """Free motion (n, N, A) from the first row that counts on."""
    motion = np.zeros((dynamics.a.shape[1], *piece.measurement.shape))
    motion[:, piece.first :] = free_motion(dynamics, len(piece.command) - piece.first)
    return motion


def _directions(dynamics: LinearFilter, piece: Piece, error: Array | None) -> Array:
    """Free motions (N, A, K) of a record, each as large as its measurement's range; none where its error says that it begins at rest."""
    if error is not None and _states(dynamics, piece, error) is None:
        return np.zeros((*piece.measurement.shape, 0))
    motion = _motion(dynamics, piece)
    flat = motion.reshape(len(motion), -1)
    sizes, turns = np.linalg.eigh(flat @ flat.T)
    kept = sizes > SMALLEST**2 * sizes[-1]
    unit = flat.T @ (turns[:, kept] / np.sqrt(sizes[kept])) * np.sqrt(flat.shape[1])
    scale = float(np.ptp(piece.measurement, axis=0).max()) * np.sqrt(sizes[kept] / sizes[-1])
    return np.asarray((unit * scale).reshape(*piece.measurement.shape, -1), dtype=np.float64)
