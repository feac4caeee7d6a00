# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Kernels of the linear stages: systems advanced over a block, row by row."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numba import njit
from numba.cpython.unsafe.tuple import tuple_setitem

from hyst_control.base.arrays import Array, Integers, Mask
from hyst_control.chain.c_code.texts import c_texts

C = c_texts(__file__)
STEP, SETTLE = (C[name] for name in ("STEP", "SETTLE"))

TINY = 1e-80
"""States below this are 0: a decaying state would else end in subnormal numbers, which processors handle a hundred times slower."""
FEW = 6  # States that fit into the processor's registers; of up to so many, empty entries of a matrix are computed too
QUAD = 4  # Rows of a matrix that are computed side by side
TOGETHER = 64  # Rows whose outputs are summed side by side: their states stay in the processor's first cache


@njit(cache=True, error_model="numpy")
def advance_linear(
    block: Array,
    a: Annotated[Array, "S n n"],
    reach: Integers,
    b: Annotated[Array, "S 3 n m"],
    late: Mask,
    c: Annotated[Array, "S m n"],
    d: Annotated[Array, "S 2 m m"],
    bias: Array,
    whole: Integers,
    state: Annotated[Array, "S n"],
    scratch: Annotated[Array, "3 m"],
    taps: Annotated[Array, "3 m"],
    history: Array,
    position: int,
    output: Array,
) -> int:
    """Run S systems of m inputs each over a block; see `Discretized`. Returns the new position."""
    length = history.shape[0]
    systems, n = state.shape
    m = c.shape[1]
    for row in range(block.shape[0]):
        for column in range(block.shape[1]):
            history[position, column] = block[row, column]
        for s in range(systems):
            for j in range(m):
                first = position - whole[s * m + j]
                first = first + length if first < 0 else first
                second = first - 1 if first > 0 else length - 1
                third = second - 1 if second > 0 else length - 1
                taps[0, j] = history[first, s * m + j]
                taps[1, j] = history[second, s * m + j]
                taps[2, j] = history[third, s * m + j]
            older, apart = late[s], n > FEW
            for i in range(n):
                value = 0.0
                if apart:
                    for j in range(reach[s, i, 0], reach[s, i, 1]):
                        value += a[s, i, j] * state[s, j]
                else:
                    for j in range(n):
                        value += a[s, i, j] * state[s, j]
                if older:
                    for j in range(m):
                        value += b[s, 0, i, j] * taps[0, j] + b[s, 1, i, j] * taps[1, j] + b[s, 2, i, j] * taps[2, j]
                else:
                    for j in range(m):
                        value += b[s, 0, i, j] * taps[0, j]
                scratch[i] = value
            for i in range(n):
                state[s, i] = scratch[i] if abs(scratch[i]) > TINY else 0.0
            for p in range(m):
                value = bias[s * m + p]
                for j in range(n):
                    value += c[s, p, j] * state[s, j]
                for j in range(m):
                    value += d[s, 0, p, j] * taps[0, j] + d[s, 1, p, j] * taps[1, j]
                output[row, s * m + p] = value
        position = position + 1 if position + 1 < length else 0
    return position


@njit(cache=True, error_model="numpy")
def advance_single(
    block: Array,
    a: Array,
    reach: Integers,
    b: Array,
    late: Mask,
    c: Array,
    d: Array,
    bias: Array,
    whole: Integers,
    state: Array,
    scratch: Array,
    history: Array,
    position: int,
    output: Array,
) -> int:
    """As `advance_linear` for systems of one input each (m = 1), one after the other: with fewer indices it is faster."""
    length = history.shape[0]
    systems, n = state.shape
    begin = position
    for s in range(systems):
        position = begin
        delay, older, apart, offset = whole[s], late[s], n > FEW, bias[s]
        matrix, x, columns, past = a[s], state[s], reach[s], history[:, s]
        newest_b, middle_b, oldest_b, gain = b[s, 0, :, 0], b[s, 1, :, 0], b[s, 2, :, 0], c[s, 0]
        newest_d, middle_d = d[s, 0, 0, 0], d[s, 1, 0, 0]
        for row in range(block.shape[0]):
            past[position] = block[row, s]
            first = position - delay
            first = first + length if first < 0 else first
            second = first - 1 if first > 0 else length - 1
            third = second - 1 if second > 0 else length - 1
            newest, middle, oldest = past[first], past[second], past[third]
            for i in range(n):
                value = 0.0
                if apart:
                    for j in range(columns[i, 0], columns[i, 1]):
                        value += matrix[i, j] * x[j]
                else:
                    for j in range(n):
                        value += matrix[i, j] * x[j]
                if older:
                    value += newest_b[i] * newest + middle_b[i] * middle + oldest_b[i] * oldest
                else:
                    value += newest_b[i] * newest
                scratch[i] = value
            value = offset
            for i in range(n):
                x[i] = scratch[i] if abs(scratch[i]) > TINY else 0.0
                value += gain[i] * x[i]
            output[row, s] = value + (newest_d * newest + middle_d * middle)
            position = position + 1 if position + 1 < length else 0
    return position


@njit(cache=True, error_model="numpy")
def advance_few(
    block: Array,
    a: Array,
    b: Array,
    late: Mask,
    c: Array,
    d: Array,
    bias: Array,
    whole: Integers,
    state: Array,
    begin_state: int,
    zeros: tuple[float, ...],
    block_zeros: tuple[float, ...],
    history: Array,
    position: int,
    output: Array,
) -> int:
    """As `advance_single`, for long blocks and `FEW` states at most: one group after the other, each of diagonal blocks of one size.

    It is compiled for each number of states and size of blocks, with its loops unrolled. The states are a tuple, which the compiler
    keeps in registers; an array would be written and read in every row. A group's output is added to that of the groups before it.
    """
    length, begin, n, width = history.shape[0], position, len(zeros), len(block_zeros)
    is_first, is_last = begin_state == 0, begin_state + n == state.shape[1]
    for s in range(state.shape[0]):
        position = begin
        delay, older, offset, past = whole[s], late[s], bias[s], history[:, s]
        matrix, gain, newest_d, middle_d = a[s], c[s, 0], d[s, 0, 0, 0], d[s, 1, 0, 0]
        newest_b, middle_b, oldest_b = b[s, 0, :, 0], b[s, 1, :, 0], b[s, 2, :, 0]
        x = zeros
        for i in range(n):
            x = tuple_setitem(x, i, state[s, begin_state + i])  # type: ignore[call-arg]
        for row in range(block.shape[0]):
            past[position] = block[row, s]
            first = position - delay
            first = first + length if first < 0 else first
            second = first - 1 if first > 0 else length - 1
            third = second - 1 if second > 0 else length - 1
            newest, middle, oldest = past[first], past[second], past[third]
            following = zeros
            for i in range(n):
                value = 0.0
                first_of_block = i // width * width
                for j in range(width):
                    value += matrix[i, first_of_block + j] * x[first_of_block + j]
                if older:
                    value += newest_b[i] * newest + middle_b[i] * middle + oldest_b[i] * oldest
                else:
                    value += newest_b[i] * newest
                following = tuple_setitem(following, i, value if abs(value) > TINY else 0.0)  # type: ignore[call-arg]
            x = following
            value = offset if is_first else output[row, s]
            for i in range(n):
                value += gain[i] * x[i]
            output[row, s] = value + (newest_d * newest + middle_d * middle) if is_last else value
            position = position + 1 if position + 1 < length else 0
        for i in range(n):
            state[s, begin_state + i] = x[i]
    return position


def quads_of(a: Annotated[Array, "S n n"]) -> tuple[Array, Integers, Integers]:
    """The entries of matrices that act, four rows side by side."""
    systems, n, _ = a.shape
    fours = -(-n // QUAD)
    filled = np.zeros((systems, fours * QUAD, n))
    filled[:, :n] = a
    by_four = filled.reshape(systems, fours, QUAD, n).transpose(0, 1, 3, 2)
    there = np.any(by_four != 0.0, axis=3)
    counts = there.sum(axis=2)
    edges = np.concatenate([[0], np.cumsum(counts)])
    size = counts.shape[1]
    ends = np.stack([edges[s * size : (s + 1) * size + 1] for s in range(systems)])
    return np.ascontiguousarray(by_four[there]), np.nonzero(there)[2], ends


@njit(cache=True, error_model="numpy")
def advance_block(
    block: Array,
    quads: Array,
    acting: Integers,
    ends: Integers,
    b: Annotated[Array, "S 3 m n"],
    late: Mask,
    c: Array,
    d: Array,
    bias: Array,
    whole: Integers,
    state: Array,
    scratch: Array,
    history: Array,
    position: int,
    output: Array,
) -> int:
    """As `advance_linear`, for long blocks: sums of the same order, but side by side for many states and many rows.

    Every state and every output is still summed one term after the other, in the same order, so that the results are the same.
    """
    length = history.shape[0]
    systems, n = state.shape
    m = c.shape[1]
    most = min(TOGETHER, block.shape[0])
    past, total = np.empty((n, most)), np.empty(most)
    newest, middle, oldest = np.empty((m, most)), np.empty((m, most)), np.empty((m, most))
    done = 0
    while done < block.shape[0]:
        count = min(most, block.shape[0] - done)
        for s in range(systems):
            place = position
            x, older = state[s], late[s]
            for row in range(count):
                for j in range(m):
                    column = s * m + j
                    history[place, column] = block[done + row, column]
                    first = place - whole[column]
                    first = first + length if first < 0 else first
                    second = first - 1 if first > 0 else length - 1
                    third = second - 1 if second > 0 else length - 1
                    newest[j, row] = history[first, column]
                    middle[j, row] = history[second, column]
                    oldest[j, row] = history[third, column]
                place = place + 1 if place + 1 < length else 0
                for quad in range(len(scratch) // QUAD):
                    one = two = three = four = 0.0
                    for k in range(ends[s, quad], ends[s, quad + 1]):
                        factor = x[acting[k]]
                        one += quads[k, 0] * factor
                        two += quads[k, 1] * factor
                        three += quads[k, 2] * factor
                        four += quads[k, 3] * factor
                    scratch[QUAD * quad] = one
                    scratch[QUAD * quad + 1] = two
                    scratch[QUAD * quad + 2] = three
                    scratch[QUAD * quad + 3] = four
                for j in range(m):
                    now, now_b = newest[j, row], b[s, 0, j]
                    if older:
                        before, long_before = middle[j, row], oldest[j, row]
                        before_b, long_before_b = b[s, 1, j], b[s, 2, j]
                        for i in range(len(scratch)):
                            scratch[i] += now_b[i] * now + before_b[i] * before + long_before_b[i] * long_before
                    else:
                        for i in range(len(scratch)):
                            scratch[i] += now_b[i] * now
                for i in range(n):
                    x[i] = scratch[i] if abs(scratch[i]) > TINY else 0.0
                for i in range(n):
                    past[i, row] = x[i]
            for p in range(m):
                for row in range(count):
                    total[row] = bias[s * m + p]
                for k in range(n):
                    gain, of = c[s, p, k], past[k]
                    for row in range(count):
                        total[row] += gain * of[row]
                for j in range(m):
                    now_d, before_d = d[s, 0, p, j], d[s, 1, p, j]
                    for row in range(count):
                        total[row] += now_d * newest[j, row] + before_d * middle[j, row]
                for row in range(count):
                    output[done + row, s * m + p] = total[row]
        position = (position + count) % length
        done += count
    return position
