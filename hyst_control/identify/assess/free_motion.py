# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Motion of a model's dynamics that goes on from before a record, such as the ringing of a mode in a part cut out of a longer run."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.chain.chain import SeriesFilter
from hyst_control.chain.linear.linear_filter import LinearFilter
from hyst_control.chain.memoryless import StaticFilter
from hyst_control.chain.stage import Sampling
from hyst_control.identify.solve.chain_batch import Decay
from hyst_control.model_file import Model
from hyst_control.records.record import Record
from hyst_control.records.session_zero import basis
from hyst_control.records.stream.row_store import blocks

ROWS = 2**16  # First rows of a record from which its motion from before is estimated
MOST_LEFT = 0.5  # Share of an error's energy that its free motion may leave where there is one
SMALLEST = 1e-4
"""Relative singular value from which a motion is estimated beside the others and the session's zero and drift."""


def without_free_motion(model: Model, data: Record, error: Annotated[Array, "N A"]) -> None:
    """Take the motion from before the record off an error, in place: the states of the dynamics that end the chain are estimated."""
    running = ending_dynamics(model, data.sample_time, data.hold)
    if running is None:
        return
    count, coupled = min(len(error), ROWS), len(running.a) == 1
    states = states_of(free_motion(running, count), error[:count], coupled)
    decays = _decays(running)
    for part in blocks(len(error)):
        for axis, decay in enumerate(decays):
            if not decay.is_over:
                error[part, axis] -= decay.rows(part.stop - part.start) @ states[:, axis]


def moves_already(motion: Annotated[Array, "n N A"], error: Annotated[Array, "N A"], coupled: bool) -> bool:
    """True where a free motion explains most of an error beside the session's zero and drift."""
    shapes = basis(slice(0, len(error)), len(error))

    def left(rows: Array) -> float:
        return float(np.sum((rows - shapes @ np.linalg.lstsq(shapes, rows, rcond=None)[0]) ** 2))

    return left(error - np.einsum("ina,ia->na", motion, states_of(motion, error, coupled))) < MOST_LEFT * left(error)


def free_motion(dynamics: LinearFilter, count: int) -> Annotated[Array, "n N A"]:
    """First `count` outputs of dynamics without an input, for each state, 1 at the beginning, by itself."""
    return np.stack([decay.rows(count).T for decay in _decays(dynamics)], axis=2)


def ending_dynamics(model: Model, sample_time: float, hold: str) -> LinearFilter | None:
    """The linear dynamics that end a chain, but for gains, offsets and curves of a sensor."""
    running = model.chain.filter(Sampling(sample_time, len(model.axes), hold))
    filters = running.filters if isinstance(running, SeriesFilter) else [running]
    moving = [each for each in filters if not isinstance(each, StaticFilter)]
    last = moving[-1] if moving else None
    return last if isinstance(last, LinearFilter) and last.a.shape[1] else None


def states_of(motion: Annotated[Array, "n N A"], error: Annotated[Array, "N A"], coupled: bool) -> Annotated[Array, "n A"]:
    """The states that fit an error best beside the session's zero and drift: of coupled axes the same for all."""
    session = basis(slice(0, len(error)), len(error))
    axes = error.shape[1]
    groups = [slice(None)] if coupled else [slice(axis, axis + 1) for axis in range(axes)]
    states = np.zeros((len(motion), axes))
    for group in groups:
        own = error[:, group]
        shapes = np.kron(session, np.eye(own.shape[1]))
        table = np.column_stack([*(column[:, group].ravel() for column in motion), shapes])
        scale = np.maximum(np.linalg.norm(table, axis=0), 1e-300)
        found = np.linalg.lstsq(table / scale, own.ravel(), rcond=SMALLEST)[0] / scale
        states[:, group] = found[: len(motion), None]
    return states


def _decays(dynamics: LinearFilter) -> list[Decay]:
    """The free motion of every output."""
    return [Decay(transition, row) for transition, rows in zip(dynamics.a, dynamics.c, strict=True) for row in rows]
