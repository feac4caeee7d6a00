# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Motion of the dynamics that goes on from before a record, such as the ringing of a mode in a part cut out of a longer run.

Where the nominal dynamics ringing freely explain most of what differs, their states are free in every hypothesis. Baseline records may
begin amid a motion as well. Those of the same command carry it over with all else that the model lacks, and the states are those of the
difference. Beside others it is subtracted from all records before: a state that is fitted to one record with an effect takes a part of it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.chain.linear.linear_filter import LinearFilter
from hyst_control.diagnose.configuration import BaselineSettings
from hyst_control.diagnose.model_error.same_command import matching
from hyst_control.diagnose.problem.per_record_stages import ErrorBasis, LearnedError
from hyst_control.diagnose.problem.problem import Piece, Problem
from hyst_control.identify.assess.free_motion import ROWS, ending_dynamics, free_motion, moves_already, states_of

SMALLEST = 1e-6  # Size of a direction, in that of the largest one, under which it is left out


def beside_clean(problem: Problem, clean: Problem, settings: BaselineSettings) -> tuple[Problem, Problem]:
    """Both problems with the motions that their records begin amid as something known, or as a session effect."""
    if all(_begin_together(piece, clean, settings) for piece in problem.pieces):
        return with_initial_motion(problem, without_initial_motion(clean) is not clean), clean
    return without_initial_motion(problem), without_initial_motion(clean)


def _begin_together(piece: Piece, clean: Problem, settings: BaselineSettings) -> bool:
    """True where a baseline record has the same command from the first row on."""
    found = matching(piece.command, clean.pieces, settings.same_command, settings.overlap)
    return any(match.shift == 0 for match in found)


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
