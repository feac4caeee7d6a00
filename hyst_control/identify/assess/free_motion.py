# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Motion of a model's dynamics that goes on from before a record, such as the ringing of a mode in a part cut out of a longer run."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.chain.chain import SeriesFilter
from hyst_control.chain.linear.linear_filter import LinearFilter
from hyst_control.chain.memoryless import StaticFilter
from hyst_control.chain.stage import Filter, Sampling
from hyst_control.model_file import Model
from hyst_control.records.record import Record
from hyst_control.records.session_zero import basis
from hyst_control.records.stream.row_store import blocks

ROWS = 2**16
"""First rows of a record that tell its motion from before."""
GONE = 1e-9
"""Share of the largest free motion under which it has died away."""
SMALLEST = 1e-10
"""Relative singular value from which a motion is told apart from the others, and from the session's zero and drift."""


def without_free_motion(model: Model, data: Record, error: Annotated[Array, "N A"]) -> None:
    """Take the motion from before the record off an error, in place: the states of the dynamics that end the chain are estimated."""
    running = _ending_dynamics(model.chain.filter(Sampling(data.sample_time, len(model.axes), data.hold)))
    if running is None or not running.a.shape[1]:
        return
    count = min(len(error), ROWS)
    columns = np.concatenate([motion for _, motion in _motions(running, count)], axis=1)
    session = basis(slice(0, count), count)
    own = [slice(None)] if len(running.a) == 1 else [slice(axis, axis + 1) for axis in range(error.shape[1])]
    states = np.zeros((len(columns), len(own)))
    for group, axes in enumerate(own):
        width = error[:, axes].shape[1]
        shapes = np.kron(session, np.eye(width))
        table = np.column_stack([*(column[:, axes].ravel() for column in columns), shapes])
        scale = np.maximum(np.linalg.norm(table, axis=0), 1e-300)
        found = np.linalg.lstsq(table / scale, error[:count, axes].ravel(), rcond=SMALLEST)[0] / scale
        states[:, group] = found[: len(columns)]
    share = states if len(own) > 1 else np.repeat(states, error.shape[1], axis=1)
    for rows, motion in _motions(running, len(error)):
        error[rows] -= np.einsum("ina,ia->na", motion, share)


def _ending_dynamics(running: Filter) -> LinearFilter | None:
    """The linear dynamics that end a chain, but for gains, offsets and curves of a sensor."""
    filters = running.filters if isinstance(running, SeriesFilter) else [running]
    moving = [each for each in filters if not isinstance(each, StaticFilter)]
    last = moving[-1] if moving else None
    return last if isinstance(last, LinearFilter) else None


def _motions(dynamics: LinearFilter, count: int) -> Iterator[tuple[slice, Annotated[Array, "n rows A"]]]:
    """Block by block what each state, 1 at the beginning, adds to the outputs without an input, until all has died away."""
    systems, states = dynamics.a.shape[:2]
    axes = systems * dynamics.c.shape[1]
    running = [dynamics.another() for _ in range(states)]
    still = [each.settle(np.zeros(axes)) for each in running]
    for i, each in enumerate(running):
        each.state[:, i] = 1.0
    largest = 0.0
    for rows in blocks(count):
        nothing = np.zeros((rows.stop - rows.start, axes))
        motion = np.stack([each.process(nothing) - zero for each, zero in zip(running, still, strict=True)])
        yield rows, motion
        largest = max(largest, float(np.abs(motion).max()))
        if float(np.abs(motion[:, -1]).max()) < GONE * largest and max(np.abs(each.state).max() for each in running) < GONE:
            return
