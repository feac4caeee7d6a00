# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Linear systems of one input each, side by side: several rows of each at once, as products of matrices.

A system's next T outputs, and its state after them, are linear in its state and in the inputs that act:

    y[k+t] = C A^(t+1) x[k-1] + Σ_s H[t, s] w[k-2+s],   x[k+T-1] = A^T x[k-1] + Σ_s G[:, s] w[k-2+s]

With H and G computed once, a long block is products of matrices, and only every T-th state follows from the one before.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from numba import njit

from hyst_control.base.arrays import Array, Integers
from hyst_control.chain.linear.discretization import Discretised
from hyst_control.chain.linear.linear_kernels import TINY

TOGETHER = 32  # Rows T that are computed at once
TAPS = TOGETHER + 2  # Inputs that act on them; the bias, and then the states, follow in the vector that their outputs are linear in
FEW = 4 * TOGETHER  # Rows of a block that is not worth the products
GROUPS = 64  # Groups of rows in one product: few enough to stay in the cache, and for BLAS to start no threads for it


@njit(cache=True, error_model="numpy")
def advance_rows(
    inputs: Annotated[Array, "L M"],
    begin: Integers,
    a: Annotated[Array, "L n n"],
    b: Annotated[Array, "L n n"],
    c: Annotated[Array, "L n n"],
    d: Annotated[Array, "L n n"],
    bias: Annotated[Array, "L n n"],
    state: Annotated[Array, "L n"],
    output: Annotated[Array, "L N"],
    done: int,
) -> None:
    """Run L systems of n states row by row, from the row `done` on."""
    n = a.shape[1]
    following = np.empty(n)
    for lane in range(len(output)):
        matrix, x, b0, b1, b2, gain = a[lane], state[lane], b[lane, 0], b[lane, 1], b[lane, 2], c[lane]
        first = begin[lane]
        for row in range(done, output.shape[1]):
            oldest, middle, newest = inputs[lane, first + row], inputs[lane, first + row + 1], inputs[lane, first + row + 2]
            for i in range(n):
                value = 0.0
                for j in range(n):
                    value += matrix[i, j] * x[j]
                following[i] = value + (b0[i] * newest + b1[i] * middle + b2[i] * oldest)
            value = bias[lane]
            for i in range(n):
                x[i] = following[i] if abs(following[i]) > TINY else 0.0
                value += gain[i] * x[i]
            output[lane, row] = value + (d[lane, 0] * newest + d[lane, 1] * middle)


@njit(cache=True, error_model="numpy")
def fill_taps(inputs: Array, begin: Integers, acting: Array) -> None:
    """Copy the inputs that act on groups of T rows."""
    lanes, groups = acting.shape[:2]
    for lane in range(lanes):
        for group in range(groups):
            first = begin[lane] + group * TOGETHER
            for tap in range(TAPS):
                acting[lane, group, tap] = inputs[lane, first + tap]


@njit(cache=True, error_model="numpy")
def advance_states(
    transition: Annotated[Array, "L n n"], driven: Annotated[Array, "L K n"], state: Annotated[Array, "L n"], acting: Array
) -> None:
    """Follow the states from one group of T rows to the next."""
    n = state.shape[1]
    following = np.empty(n)
    for lane in range(len(state)):
        matrix, x = transition[lane], state[lane]
        for group in range(driven.shape[1]):
            for i in range(n):
                acting[lane, group, TAPS + 1 + i] = x[i]
                value = driven[lane, group, i]
                for j in range(n):
                    value += matrix[i, j] * x[j]
                following[i] = value
            for i in range(n):
                x[i] = following[i] if abs(following[i]) > TINY else 0.0


@njit(cache=True, error_model="numpy")
def group_matrices(
    a: Annotated[Array, "L n n"],
    b: Annotated[Array, "L 3 n"],
    c: Annotated[Array, "L n"],
    d: Annotated[Array, "L 2"],
    bias: Annotated[Array, "L"],
) -> tuple[Array, Array, Array]:
    """Matrices that advance L systems by T rows."""
    lanes, n = c.shape
    driven, transition = np.zeros((lanes, TAPS, n)), np.zeros((lanes, n, n))
    outputs = np.zeros((lanes, TAPS + 1 + n, TOGETHER))
    pulse, following = np.zeros(n), np.zeros(n)
    for lane in range(lanes):
        # An input of 1 at one tap: the two that are older than the first row miss what acted before it.
        for tap in range(3):
            for i in range(n):
                pulse[i] = b[lane, 2 - tap, i]
            for row in range(TOGETHER):
                if row > 0:
                    for i in range(n):
                        following[i] = b[lane, 2 - tap + row, i] if tap - row >= 0 else 0.0
                        for j in range(n):
                            following[i] += a[lane, i, j] * pulse[j]
                    for i in range(n):
                        pulse[i] = following[i] if abs(following[i]) > TINY else 0.0
                value = 0.0
                for i in range(n):
                    value += c[lane, i] * pulse[i]
                if tap == 2:  # the same for every input of these rows, each later by a row
                    for first in range(TOGETHER - row):
                        outputs[lane, 2 + first, first + row] = value
                    for i in range(n):
                        driven[lane, TAPS - 1 - row, i] = pulse[i]
                else:
                    outputs[lane, tap, row] = value
            if tap < 2:
                for i in range(n):
                    driven[lane, tap, i] = pulse[i]
        for row in range(TOGETHER):
            outputs[lane, row + 2, row] += d[lane, 0]
            outputs[lane, row + 1, row] += d[lane, 1]
            outputs[lane, TAPS, row] = bias[lane]
        for column in range(n):
            for i in range(n):
                pulse[i] = 1.0 if i == column else 0.0
            for row in range(TOGETHER):
                value = 0.0
                for i in range(n):
                    following[i] = 0.0
                    for j in range(n):
                        following[i] += a[lane, i, j] * pulse[j]
                for i in range(n):
                    pulse[i] = following[i] if abs(following[i]) > TINY else 0.0
                    value += c[lane, i] * pulse[i]
                outputs[lane, TAPS + 1 + column, row] = value
            for i in range(n):
                transition[lane, i, column] = pulse[i]
    return driven, transition, outputs


class LinearLanes:
    """Linear systems of one input each, running side by side. The outputs are those of a `LinearFilter` of each, to rounding."""

    def __init__(self, systems: Sequence[Discretised], whole: Sequence[int]) -> None:
        self._whole = np.array(whole, dtype=np.int64)
        self._a = np.array([each.A for each in systems])
        self._b = np.array([each.B[:, :, 0] for each in systems])
        self._c = np.array([each.C[0] for each in systems])
        self._d = np.array([each.D[:, 0, 0] for each in systems])
        self._bias = np.array([each.bias[0] for each in systems])
        self._rest = np.linalg.solve(np.eye(self._a.shape[1]) - self._a, self._b.sum(axis=1)[:, :, None])[:, :, 0]
        self._static_gain = (self._c * self._rest).sum(axis=1) + self._d.sum(axis=1)
        self._state = np.zeros_like(self._rest)
        self._past = np.zeros((len(systems), int(self._whole.max()) + 2))
        self._driven, self._transition, self._outputs = group_matrices(self._a, self._b, self._c, self._d, self._bias)

    def settle(self, values: Annotated[Array, "L"]) -> Annotated[Array, "L"]:
        """Come to rest at constant inputs."""
        self._past[:] = values[:, None]
        self._state = self._rest * values[:, None]
        return np.asarray(self._static_gain * values + self._bias)

    @property
    def count(self) -> int:
        """Number of systems."""
        return len(self._state)

    def process(self, blocks: Sequence[Array] | Array, output: Annotated[Array, "L N"] | None = None) -> Annotated[Array, "L N"]:
        """Filter blocks of consecutive samples, into `output` where there is one."""
        count, kept = len(blocks[0]), self._past.shape[1]
        lanes, n = self._state.shape
        inputs = np.empty((lanes, kept + count))
        inputs[:, :kept] = self._past
        for lane, block in enumerate(blocks):
            inputs[lane, kept:] = block
        self._past = inputs[:, count:].copy()
        begin = kept - 2 - self._whole
        output = np.empty((lanes, count)) if output is None else output
        acting = np.ones((lanes, min(count // TOGETHER, GROUPS), TAPS + 1 + n))
        done = 0
        while count - done >= FEW:
            groups = min((count - done) // TOGETHER, GROUPS)
            following = done + groups * TOGETHER
            self._groups(inputs, begin + done, acting[:, :groups], output[:, done:following].reshape(lanes, groups, TOGETHER))
            done = following
        advance_rows(inputs, begin, self._a, self._b, self._c, self._d, self._bias, self._state, output, done)
        return output

    def _groups(self, inputs: Array, begin: Integers, acting: Array, output: Array) -> None:
        """Write the outputs (L, K, T) of K groups of T rows, of which `acting` gets what they are linear in."""
        fill_taps(inputs, begin, acting)
        with np.errstate(all="ignore"):  # as in a loop: an input beyond all bounds is for those to see who use the output
            advance_states(self._transition, acting[:, :, :TAPS] @ self._driven, self._state, acting)
            np.matmul(acting, self._outputs, out=output)
