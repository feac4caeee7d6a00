# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Linear systems running: one per axis, or one for all axes."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from hyst_control.base.arrays import Array, Integers, Mask
from hyst_control.chain.c_code.c_code import CCode, integers, reals
from hyst_control.chain.linear.discretization import Discretised
from hyst_control.chain.linear.linear_kernels import (
    FEW,
    QUAD,
    SETTLE,
    STEP,
    TOGETHER,
    advance_block,
    advance_few,
    advance_linear,
    advance_single,
    quads_of,
)
from hyst_control.chain.stage import Filter

FLOAT_LOSS = 1e-6  # Share of a signal that a system run in single precision may lose to rounding; a slower one is run in double
MOST_CANCELLED = 100.0
"""Parts of an output over the output, up to which rounding them to float does no harm: an inverse of slow dynamics has more."""
NOTHING_LEFT = 1e-12  # Share of its parts that the output at rest is of a system without one


class LinearFilter(Filter):
    """Streaming linear systems: one per axis, or one for all axes."""

    hold = "foh"

    def __init__(self, systems: list[Discretised], whole: Integers | Array) -> None:
        n = max(len(system.A) for system in systems)
        m = systems[0].C.shape[0]
        count = len(systems)
        self.a, self.b = np.zeros((count, n, n)), np.zeros((count, 3, n, m))
        self.c, self.d = np.zeros((count, m, n)), np.zeros((count, 2, m, m))
        for s, system in enumerate(systems):
            order = len(system.A)
            self.a[s, :order, :order], self.b[s, :, :order] = system.A, system.B
            self.c[s, :, :order], self.d[s] = system.C, system.D
        self.bias = np.concatenate([system.bias for system in systems])
        # Modes that do not act on each other leave most of a matrix empty: only what is there is computed.
        self.reach = reach_of(self.a)
        self.late: Mask = np.any(self.b[:, 1:] != 0.0, axis=(1, 2, 3))
        if m > 1:
            self.quads, self.acting, self.ends = quads_of(self.a)
            self.by_input = np.zeros((count, 3, m, n + -n % QUAD))
            self.by_input[..., :n] = self.b.transpose(0, 1, 3, 2)
        # State and output at rest, for a unit input; the states that fill up a shorter system stay 0.
        self.rest = np.linalg.solve(np.eye(n) - self.a, self.b.sum(axis=1))
        self.static_gain = self.c @ self.rest + self.d.sum(axis=1)
        self.whole = whole.astype(np.int64)
        self.groups = [
            (begin, width, self.a[:, begin:end, begin:end].copy(), self.b[:, :, begin:end].copy(), self.c[:, :, begin:end].copy())
            for begin, end, width in _groups(self.a)
        ]
        self._begin()

    def _begin(self) -> None:
        count, _, n, m = self.b.shape
        self.state, self.scratch, self.taps = np.zeros((count, n)), np.zeros(n), np.zeros((3, m))
        self.history = np.zeros((int(self.whole.max()) + 3, count * m))
        self.position = 0

    def another(self) -> LinearFilter:
        """A filter of the same systems with a state of its own."""
        found = type(self).__new__(type(self))  # as `copy.copy`, without its detour over pickling
        vars(found).update(vars(self))
        found._begin()
        return found

    def settle(self, value: Array) -> Array:
        value = np.asarray(value, dtype=float)
        self.history[:] = value
        self.position = 0
        self.state[:] = _times(self.rest, value)
        return np.asarray(_times(self.static_gain, value).reshape(-1) + self.bias)

    def process(self, block: Array) -> Array:
        output = np.empty_like(block)
        is_single, is_long = self.c.shape[1] == 1, len(block) >= TOGETHER
        system = self.late, self.c, self.d, self.bias, self.whole, self.state
        end = self.history, self.position, output
        if is_long and not is_single:
            work = np.empty(self.by_input.shape[3])
            self.position = advance_block(block, self.quads, self.acting, self.ends, self.by_input, *system, work, *end)
        elif is_long and self.groups:
            for begin, width, a, b, c in self.groups:
                few = self.late, c, self.d, self.bias, self.whole, self.state, begin, (0.0,) * a.shape[1], (0.0,) * width
                is_last = begin + a.shape[1] == self.a.shape[1]
                past = self.history if is_last else self.history.copy()  # every group begins with the inputs before the block
                position = advance_few(block, a, b, *few, past, self.position, output)
            self.position = position
        elif is_single:
            self.position = advance_single(block, self.a, self.reach, self.b, *system, self.scratch, *end)
        else:
            self.position = advance_linear(block, self.a, self.reach, self.b, *system, self.scratch, self.taps, *end)
        return output

    def c_code(self) -> CCode:
        count, _, n, m = self.b.shape
        slowest = max((float(np.abs(np.linalg.eigvals(a)).max()) for a in self.a if n), default=0.0)
        wide = bool(np.finfo(np.float32).eps > FLOAT_LOSS * (1.0 - slowest)) or self._cancellation() > MOST_CANCELLED
        columns = (int(self.whole.max()) + 3, count * m)
        return CCode(
            "linear",
            STEP,
            SETTLE,
            {"SYSTEMS": count, "ORDER": n, "STATES": max(n, 1), "INPUTS": m, "LENGTH": columns[0]},
            {
                "a": reals(self.a, "[system][state][state]", wide),
                "b": reals(self.b, "[system][newest, middle, oldest input][state][input]", wide),
                "c": reals(self.c, "[system][output][state]", wide),
                "d": reals(self.d, "[system][newest, middle input][output][input]", wide),
                "bias": reals(self.bias, "output unit", wide),
                "rest": reals(self.rest, "state at rest for a unit input", wide),
                "gain": reals(self.static_gain, "output at rest for a unit input", wide),
                "reach": integers(self.reach, "first and past-the-last column of a that acts"),
                "late": integers(self.late, "whether any but the newest input acts"),
                "whole": integers(self.whole, "samples of delay"),
            },
            {
                "x": reals(self.state, "state of every system", wide),
                "history": reals(np.zeros(columns), "ring of past inputs", wide),
                "position": integers(0, "of the newest in the ring"),
            },
            wide=wide,
        )

    def _cancellation(self) -> float:
        """Largest ratio of the sum of the absolute parts of an output at rest to that output, where it is not 0 but for rounding."""
        parts = (np.abs(self.c) @ np.abs(self.rest) + np.abs(self.d).sum(axis=1)).max(axis=(1, 2))
        whole = np.abs(self.static_gain).max(axis=(1, 2))
        return float((parts / np.where(whole > NOTHING_LEFT * parts, whole, np.inf)).max())


def _times(matrices: Array, value: Array) -> Array:
    """Products (S, p) of matrices (S, p, m) with the parts of a vector (S m,), summed one input after the other."""
    parts = value.reshape(len(matrices), 1, -1)
    total: Array = matrices[:, :, 0] * parts[:, :, 0]
    for j in range(1, matrices.shape[2]):
        total = total + matrices[:, :, j] * parts[:, :, j]
    return total


def _blocks(a: Array) -> list[tuple[int, int]]:
    """First and past-the-last state of the blocks along the diagonal of matrices (S, n, n); few states are one block."""
    n = a.shape[1]
    if n <= FEW:
        return [(0, n)] * (n > 0)
    acting = np.any(a != 0.0, axis=0)
    return list(pairwise([0, *(k for k in range(1, n + 1) if not (acting[:k, k:].any() or acting[k:, :k].any()))]))


def _groups(a: Array) -> list[tuple[int, int, int]]:
    """First and past-the-last state of groups of `FEW` states at most, and the size of their blocks; none where a block is larger."""
    found = list[tuple[int, int, int]]()
    for begin, end in _blocks(a):
        width = end - begin
        if width > FEW:
            return []
        if found and found[-1][2] == width and end - found[-1][0] <= FEW:
            begin = found.pop()[0]
        found.append((begin, end, width))
    return found


def reach_of(a: Array) -> Integers:
    """First and past-the-last column (S, n, 2) that acts, of every row of matrices (S, n, n); in small blocks all that there are."""
    there, n = a != 0.0, a.shape[2]
    if n <= FEW:
        return np.tile(np.array([0, n]), (*a.shape[:2], 1))
    first, last = there.argmax(axis=2), n - there[:, :, ::-1].argmax(axis=2)
    reach = np.stack([first, np.where(there.any(axis=2), last, first)], axis=2)
    for begin, end in _blocks(a):
        if end - begin <= FEW:
            reach[:, begin:end] = begin, end
    return reach
