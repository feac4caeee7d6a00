# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Exact discretization of linear systems for the hold of their input."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import expm

from hyst_control.base.arrays import Array
from hyst_control.chain.bounded_cache import remembered
from hyst_control.chain.linear.linear_system import LinearSystem
from hyst_control.chain.stage import Sampling


@dataclass(frozen=True)
class Discretised:
    """x[k] = A x[k-1] + sum_i B[i] w[k-i], y[k] = C x[k] + sum_i D[i] w[k-i] + bias, with w the input delayed by whole samples.

    A (n, n), B (3, n, m), C (p, n), D (2, p, m), bias (p,).
    """

    A: Array
    B: Array
    C: Array
    D: Array
    bias: Array


@remembered
def discretise(system: LinearSystem, fraction: Array, sampling: Sampling) -> Discretised:
    """Advance a system exactly by one sample: older input segment up to the kink at `fraction`, newer one after it."""
    ts = sampling.sample_time
    n, m = system.B.shape
    b_taps, d_taps = np.zeros((3, n, m)), np.zeros((2, len(system.D), m))
    transition = np.eye(n)
    for j, f in enumerate(fraction.tolist()):
        column, direct = system.B[:, j : j + 1], system.D[:, j]
        until, older = _held_input(system.A, column, f * ts)
        carried, newer = _held_input(system.A, column, (1.0 - f) * ts)
        transition, older = carried @ until, carried @ older
        if sampling.hold == "zoh":
            b_taps[0, :, j] = newer.sum(axis=1)
            b_taps[1, :, j] = older.sum(axis=1)
            d_taps[0, :, j] = direct
        else:
            # The input at the interval's start, kink and end lies between the samples w[k], w[k-1] and w[k-2]: their shares, in this order.
            b_taps[0, :, j] = (1.0 - f) * newer[:, 1]
            b_taps[1, :, j] = (1.0 - f) * older[:, 0] + (older[:, 1] + newer[:, 0]) + f * newer[:, 1]
            b_taps[2, :, j] = f * older[:, 0]
            d_taps[0, :, j] = (1.0 - f) * direct
            d_taps[1, :, j] = f * direct
    return Discretised(transition, b_taps, system.C, d_taps, system.bias)


def discretise_average(system: LinearSystem, fraction: Array, sampling: Sampling) -> Discretised:
    """As `discretise`, but the output is its mean over the interval: its integral, which starts from 0 in every interval."""
    n, p = len(system.A), len(system.D)
    a = np.zeros((n + p, n + p))
    a[:n, :n], a[n:, :n] = system.A, system.C / sampling.sample_time
    b = np.vstack([system.B, system.D / sampling.sample_time])
    c = np.hstack([np.zeros((p, n)), np.eye(p)])
    step = discretise(LinearSystem(a, b, c, np.zeros_like(system.D), system.bias), fraction, sampling)
    fresh = step.A.copy()
    fresh[:, n:] = 0.0
    return replace(step, A=fresh)


def _held_input(a: Array, b: Array, time: float) -> tuple[Array, Array]:
    """Transition (n, n), and states (n, 2) reached from rest for an input that runs straight from 1 to 0, and from 0 to 1."""
    n = len(a)
    if time <= 0.0 or n == 0:
        return np.eye(n), np.zeros((n, 2))
    # Van Loan: the exponential of [[A, B, 0], [0, 0, 1/T], [0, 0, 0]] holds the step and the ramp response.
    block = np.zeros((n + 2, n + 2))
    block[:n, :n] = a
    block[:n, n : n + 1] = b
    block[n, n + 1] = 1.0 / time
    exponential = expm(block * time)
    rising = exponential[:n, n + 1]
    return exponential[:n, :n], np.stack([exponential[:n, n] - rising, rising], axis=1)
