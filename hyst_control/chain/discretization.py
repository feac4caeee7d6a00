"""Exact discretization of linear systems for the hold of their input."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import expm

from hyst_control.chain.bounded_cache import remembered
from hyst_control.chain.linear_system import LinearSystem
from hyst_control.chain.parameter import Array
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
    """Advance a system exactly by one sample.

    The interval falls into two parts: up to the kink at `fraction` the input is the older segment, after it the newer one.

    Parameters
    ----------
    system
        Continuous-time system.
    fraction
        (m,), of a sample, by which the inputs are late: 0 <= fraction < 1.
    sampling
        Clock of the filter.
    """
    ts = sampling.sample_time
    n, m = system.B.shape
    b_taps, d_taps = np.zeros((3, n, m)), np.zeros((2, len(system.D), m))
    transition = expm(system.A * ts)
    carried = {f: expm(system.A * (1.0 - f) * ts) if f else transition for f in set(fraction.tolist())}
    for j in range(m):
        f = fraction[j]
        column = system.B[:, j : j + 1]
        first_start, first_end = _held_input(system.A, column, f * ts)
        second_start, second_end = _held_input(system.A, column, (1.0 - f) * ts)
        older, newer = carried[float(f)] @ np.hstack([first_start, first_end]), np.hstack([second_start, second_end])
        if sampling.hold == "zoh":
            b_taps[0, :, j] = newer.sum(axis=1)
            b_taps[1, :, j] = older.sum(axis=1)
            d_taps[0, :, j] = system.D[:, j]
        else:
            # Values at the start, the kink and the end of the interval from the samples w[k], w[k-1], w[k-2].
            start, kink, end = np.array([0.0, 1.0 - f, f]), np.array([0.0, 1.0, 0.0]), np.array([1.0 - f, f, 0.0])
            weights = np.outer(start, older[:, 0]) + np.outer(kink, older[:, 1] + newer[:, 0]) + np.outer(end, newer[:, 1])
            b_taps[:, :, j] = weights
            d_taps[:, :, j] = np.outer(end[:2], system.D[:, j])
    return Discretised(transition, b_taps, system.C, d_taps, system.bias)


def discretise_average(system: LinearSystem, fraction: Array, sampling: Sampling) -> Discretised:
    """As `discretise`, but the output is its mean over the interval: its integral, which starts from 0 in every interval.

    Parameters
    ----------
    system, fraction, sampling
        As for `discretise`.
    """
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
    """State reached from rest over `time` for an input that runs straight from 1 to 0, and from 0 to 1: two columns (n, 1)."""
    n = len(a)
    if time <= 0.0 or n == 0:
        return np.zeros((n, 1)), np.zeros((n, 1))
    # Van Loan: the exponential of [[A, B, 0], [0, 0, 1/T], [0, 0, 0]] holds the step and the ramp response.
    block = np.zeros((n + 2, n + 2))
    block[:n, :n] = a
    block[:n, n : n + 1] = b
    block[n, n + 1] = 1.0 / time
    exponential = expm(block * time)
    step, ramp = exponential[:n, n : n + 1], exponential[:n, n + 1 : n + 2]
    return step - ramp, ramp
