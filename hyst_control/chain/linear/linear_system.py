# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Linear continuous-time systems as matrices."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dgebal

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.chain.bounded_cache import remembered

MOST_SKEW = 1e6  # Condition number of a system's modes up to which they are its states: rounding errors grow by it


@dataclass(frozen=True)
class LinearSystem:
    """dx/dt = A x + B u, y = C x + D u + bias; A (n, n), B (n, m), C (p, n), D (p, m), bias (p,)."""

    A: Array
    B: Array
    C: Array
    D: Array
    bias: Array

    def then(self, following: LinearSystem) -> LinearSystem:
        """Series of this system and the one `following` it."""
        upper = np.hstack([self.A, np.zeros((len(self.A), len(following.A)))])
        a = np.vstack([upper, np.hstack([following.B @ self.C, following.A])])
        b = np.vstack([self.B, following.B @ self.D])
        c = np.hstack([following.D @ self.C, following.C])
        # The bias is constant, so what follows passes it on with its static gain.
        return LinearSystem(a, b, c, following.D @ self.D, following.bias + following.static_gain() @ self.bias)

    def static_gain(self) -> Array:
        """Gain (p, m) at rest. Raises `InputError` for an integrator, which has none."""
        if not len(self.A):
            return self.D
        try:
            return self.D - self.C @ np.linalg.solve(self.A, self.B)
        except np.linalg.LinAlgError:
            raise InputError("den: the system integrates (a pole at s = 0) and never comes to rest: remove that pole") from None

    def balanced(self) -> LinearSystem:
        """The same system with its states scaled so that the matrix exponential loses no digits."""
        if not len(self.A):
            return self
        # LAPACK itself: the checks of `scipy.linalg.matrix_balance` take ten times as long as the balancing.
        a, _, _, scale, _ = dgebal(np.asarray_chkfinite(self.A), scale=1, permute=0)
        return LinearSystem(a, self.B / scale[:, None], self.C * scale, self.D, self.bias)

    def by_modes(self) -> LinearSystem:
        """The same system with its real modes as states, which do not act on each other; as it is where its modes are too much alike."""
        poles, vectors = np.linalg.eig(self.A)
        pairs, real = np.flatnonzero(poles.imag > 0.0), np.flatnonzero(poles.imag == 0.0)
        parts = [np.column_stack([vector.real, vector.imag]) for vector in vectors[:, pairs].T] + [vectors[:, real].real]
        basis = np.hstack(parts)
        basis = basis / np.linalg.norm(basis, axis=0)
        if np.linalg.cond(basis) > MOST_SKEW:
            return self
        within = block_diagonal(*(np.ones((2, 2)) for _ in pairs), np.eye(len(real)))
        a, b = np.linalg.solve(basis, self.A @ basis) * within, np.linalg.solve(basis, self.B)
        return LinearSystem(a, b, self.C @ basis, self.D, self.bias)


THROUGH = LinearSystem(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.ones((1, 1)), np.zeros(1))
"""System of one input that passes it on."""


def block_diagonal(*blocks: NDArray[np.floating[Any]]) -> Array:
    """Put real matrices along the diagonal of one; `scipy.linalg.block_diag` takes twenty times as long, for its checks."""
    whole = np.zeros((sum(len(block) for block in blocks), sum(block.shape[1] for block in blocks)))
    row = column = 0
    for block in blocks:
        rows, columns = block.shape
        whole[row : row + rows, column : column + columns] = block
        row, column = row + rows, column + columns
    return whole


def stacked(systems: list[LinearSystem]) -> LinearSystem:
    """One system of several `systems` side by side, each on its own inputs and outputs."""
    a, b, c, d = (block_diagonal(*(getattr(system, part) for system in systems)) for part in "ABCD")
    return LinearSystem(a, b, c, d, np.concatenate([system.bias for system in systems]))


@remembered
def transfer_function_system(num: Array, den: Array) -> LinearSystem:
    """Controllable canonical form of num(s)/den(s), descending powers, in a time scale that keeps its entries near one."""
    num, den = (np.trim_zeros(np.atleast_1d(each), "f") for each in (num, den))
    if not len(num):
        num = np.zeros(1)
    order = len(den) - 1
    if len(num) > len(den):
        raise InputError(f"num: degree {len(num) - 1} over den of degree {order} is improper: a sampled signal has no derivative")
    num, den = np.concatenate([np.zeros(len(den) - len(num)), num]) / den[0], den / den[0]
    # s = w p: coefficients of p^k are divided by w^(order - k), with w the geometric mean of the poles' sizes.
    last = int(np.flatnonzero(den)[-1])
    w = abs(den[last]) ** (1.0 / last) if last else 1.0
    powers = w ** np.arange(order + 1)
    num, den = num / powers, den / powers
    a = np.zeros((order, order))
    if order:
        a[0] = -den[1:]
        a[1:, :-1] = np.eye(order - 1)
    b = np.zeros((order, 1))
    b[:1] = 1.0
    c = (num[1:] - num[0] * den[1:]).reshape(1, order)
    return LinearSystem(a * w, b * w, c, np.array([[num[0]]]), np.zeros(1)).balanced()
