"""Kernels of the linear stages: systems advanced over a block, row by row."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hyst_control.chain.parameter import Array

TINY = 1e-80
"""States below this are 0: a decaying state would else end in subnormal numbers, which processors handle a hundred times slower."""
CLOSE = 8
"""States up to which empty entries of a matrix are computed too: leaving them out costs more than it saves."""


STEP = """
const int length = LENGTH;
number next[STATES];
for (int column = 0; column < AXES; column++) {
    s->history[s->position][column] = in[column];
}
for (int i = 0; i < SYSTEMS; i++) {
    number newest[INPUTS];
    number middle[INPUTS];
    number oldest[INPUTS];
    for (int j = 0; j < INPUTS; j++) {
        int first = s->position - p->whole[(i * INPUTS) + j];
        first = (first < 0) ? (first + length) : first;
        const int second = (first > 0) ? (first - 1) : (length - 1);
        const int third = (second > 0) ? (second - 1) : (length - 1);
        newest[j] = s->history[first][(i * INPUTS) + j];
        middle[j] = s->history[second][(i * INPUTS) + j];
        oldest[j] = s->history[third][(i * INPUTS) + j];
    }
    for (int row = 0; row < ORDER; row++) {
        number value = (number)0.0;
        for (int j = p->reach[i][row][0]; j < p->reach[i][row][1]; j++) {
            value += p->a[i][row][j] * s->x[i][j];
        }
        if (p->late[i] != 0) {
            for (int j = 0; j < INPUTS; j++) {
                value += ((p->b[i][0][row][j] * newest[j]) + (p->b[i][1][row][j] * middle[j])) + (p->b[i][2][row][j] * oldest[j]);
            }
        } else {
            for (int j = 0; j < INPUTS; j++) {
                value += p->b[i][0][row][j] * newest[j];
            }
        }
        next[row] = value;
    }
    for (int row = 0; row < ORDER; row++) {
        const number size = (next[row] < (number)0.0) ? -next[row] : next[row];
        s->x[i][row] = (size > (number)TINY) ? next[row] : (number)0.0;
    }
    for (int row = 0; row < INPUTS; row++) {
        number value = p->bias[(i * INPUTS) + row];
        for (int j = 0; j < ORDER; j++) {
            value += p->c[i][row][j] * s->x[i][j];
        }
        for (int j = 0; j < INPUTS; j++) {
            value += (p->d[i][0][row][j] * newest[j]) + (p->d[i][1][row][j] * middle[j]);
        }
        out[(i * INPUTS) + row] = (real)value;
    }
}
s->position = ((s->position + 1) < length) ? (s->position + 1) : 0;
"""
"""`advance_linear` and `advance_single` in C: both sum in the same order."""

SETTLE = """
s->position = 0;
for (int row = 0; row < LENGTH; row++) {
    for (int column = 0; column < AXES; column++) {
        s->history[row][column] = in[column];
    }
}
for (int i = 0; i < SYSTEMS; i++) {
    for (int row = 0; row < ORDER; row++) {
        number value = p->rest[i][row][0] * (number)in[i * INPUTS];
        for (int j = 1; j < INPUTS; j++) {
            value = value + (p->rest[i][row][j] * (number)in[(i * INPUTS) + j]);
        }
        s->x[i][row] = value;
    }
    for (int row = 0; row < INPUTS; row++) {
        number value = p->gain[i][row][0] * (number)in[i * INPUTS];
        for (int j = 1; j < INPUTS; j++) {
            value = value + (p->gain[i][row][j] * (number)in[(i * INPUTS) + j]);
        }
        out[(i * INPUTS) + row] = (real)(value + p->bias[(i * INPUTS) + row]);
    }
}
"""
"""`LinearFilter.settle` in C."""


@njit(cache=True, error_model="numpy")
def advance_linear(
    block: Array,
    a: Array,
    reach: NDArray[np.int64],
    b: Array,
    late: NDArray[np.bool_],
    c: Array,
    d: Array,
    bias: Array,
    whole: NDArray[np.int64],
    state: Array,
    scratch: Array,
    taps: Array,
    history: Array,
    position: int,
    output: Array,
) -> int:
    """Run S systems of m inputs each over a block; see `Discretized`. Returns the new position.

    Parameters
    ----------
    block, output
        (N, S m): input, and output that is filled in.
    a
        (S, n, n).
    reach
        (S, n, 2), first and past-the-last nonzero column of the rows of a.
    b
        (S, 3, n, m).
    late
        (S,), whether any but the newest input acts.
    c
        (S, m, n).
    d
        (S, 2, m, m).
    bias, whole
        (S m,): constant of the output, delay in samples.
    state
        (S, n), updated.
    scratch, taps
        (n,) and (3, m), work space.
    history, position
        (L, S m), ring of past inputs, and its write position.
    """
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
            older, apart = late[s], n > CLOSE
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
    reach: NDArray[np.int64],
    b: Array,
    late: NDArray[np.bool_],
    c: Array,
    d: Array,
    bias: Array,
    whole: NDArray[np.int64],
    state: Array,
    scratch: Array,
    history: Array,
    position: int,
    output: Array,
) -> int:
    """As `advance_linear` for systems of one input each (m = 1), one after the other: with fewer indices it is faster.

    Parameters
    ----------
    block, a, reach, b, late, c, d, bias, whole, state, scratch, history, position, output
        As for `advance_linear`, with m = 1.
    """
    length = history.shape[0]
    systems, n = state.shape
    begin = position
    for s in range(systems):
        position = begin
        delay, older, apart, offset = whole[s], late[s], n > CLOSE, bias[s]
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
