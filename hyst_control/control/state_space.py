# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The linear part of a model as one discrete state space, for other programs."""

from __future__ import annotations

from collections.abc import Sequence
from functools import reduce
from typing import NamedTuple

import numpy as np
from scipy.linalg import block_diag

from hyst_control.base.arrays import Array, Integers
from hyst_control.base.errors import InputError
from hyst_control.chain import Chain, Sampling, Stage
from hyst_control.chain.chain import ParallelFilter, SeriesFilter
from hyst_control.chain.linear.linear_filter import LinearFilter
from hyst_control.chain.stage import Filter

ABSORBED = 1e-12  # Relative residual up to which a delay of the output is one of the states


class Discrete(NamedTuple):
    """State space s[k+1] = A s[k] + B u[k], y[k] = C s[k] + D u[k]."""

    a: Array
    b: Array
    c: Array
    d: Array


def state_space(stages: Sequence[Stage], axes: int, sample_time: float) -> Discrete:
    """Realize linear stages from the held command[k] to measurement[k]."""
    found = _realized(Chain(tuple(stages)).filter(Sampling(sample_time, axes, "zoh")), axes)
    # A filter's output is the sample at the interval's end, measurement[k + 1]: mostly a sum of the states that are there by then.
    ahead = np.hstack([found.a, found.b])
    wanted = np.hstack([found.c, found.d])
    c = wanted @ np.linalg.pinv(ahead)
    if np.linalg.norm(c @ ahead - wanted) <= ABSORBED * np.linalg.norm(wanted):
        return Discrete(found.a, found.b, c, np.zeros_like(found.d))
    return then(found, _delay(np.ones(axes, np.int64)))


def _realized(running: Filter, axes: int) -> Discrete:
    if isinstance(running, SeriesFilter):
        return reduce(then, [_realized(part, axes) for part in running.filters], _delay(np.zeros(axes, np.int64)))
    if isinstance(running, ParallelFilter):
        return beside([_realized(part, axes) for part in running.filters])
    if not isinstance(running, LinearFilter):
        raise InputError("chain: has a stage without a linear description")
    systems = [_system(running, index) for index in range(len(running.a))]
    together = Discrete(*(block_diag(*matrices) for matrices in zip(*systems, strict=True)))
    return then(_delay(running.whole), together)


def _system(running: LinearFilter, index: int) -> Discrete:
    """One system of a filter; its states are x[k - 1], and as many of the inputs before as act."""
    a, (b0, b1, b2), c, (d0, d1) = running.a[index], running.b[index], running.c[index], running.d[index]
    n, m = b0.shape
    taps = 2 if b2.any() else 1 if b1.any() or d1.any() else 0
    earlier = np.hstack([a, *[b1, b2][:taps]])
    shift = np.hstack([np.zeros((m * taps, n)), np.eye(m * taps, k=-m)])
    direct = np.hstack([np.zeros((len(c), n)), *[d1, np.zeros_like(d1)][:taps]])
    newest = np.vstack([b0, np.eye(m * taps, m)])
    return Discrete(np.vstack([earlier, shift]), newest, c @ earlier + direct, c @ b0 + d0)


def _delay(ticks: Integers) -> Discrete:
    """Delays of channels by whole numbers of ticks."""
    parts = [(np.eye(n, k=-1), np.eye(n, 1), np.eye(1, n, k=n - 1), np.full((1, 1), float(n == 0))) for n in ticks.tolist()]
    return Discrete(*(block_diag(*matrices) for matrices in zip(*parts, strict=True)))


def beside(parts: Sequence[Discrete]) -> Discrete:
    """Systems fed alike, outputs added."""
    a, b, c, d = zip(*parts, strict=True)
    return Discrete(block_diag(*a), np.vstack(b), np.hstack(c), np.sum(d, axis=0))


def then(first: Discrete, second: Discrete) -> Discrete:
    """Two systems in series."""
    corner = np.zeros((len(first.a), len(second.a)))
    return Discrete(
        np.block([[first.a, corner], [second.b @ first.c, second.a]]),
        np.vstack([first.b, second.b @ first.d]),
        np.hstack([second.d @ first.c, second.c]),
        second.d @ first.d,
    )
