# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Inversion of the whole model over a reference known from end to end: the ceiling for every compensator.

The command is improved by iterations of frequency-domain learning on the full nonlinear model (after Ghosh and Paden, "Nonlinear
repetitive control", IEEE TAC 45 (2000), and Kim and Zou, "A modeling-free inversion-based iterative feedforward control",
IEEE/ASME Trans. Mechatronics 18 (2013)):

    u_j+1 = u_j + F^-1 { Q (P^H P + damping I)^-1 P^H F { reference - y[u_j] } }

with P the sampled response of the model linearized at its mean slope, matrices over the axes, so coupled axes, delays and
non-minimum-phase zeros need nothing special. It is the regularized least-squares step on the lifted system, whose matrix P
diagonalises. Q learns slow errors first: its bandwidth is widened by half whenever an iteration no longer brings a tenth, until
four times in a row nothing is gained. Learning everything at once ends three times worse with the HAMPI model, whose rate term
acts like a right-half-plane zero: fast errors that the linear P does not describe are then learnt first, and stay.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.control.feedforward.compensator import drive_limits, mean_line
from hyst_control.control.linearization import linearized, sampled_response
from hyst_control.model_file import Model, simulate

ITERATIONS = 100


@dataclass(frozen=True)
class LiftedInverse:
    """command (N, A) V, the model's measurement (N, A) for it, and the rms error after each iteration (measurement unit)."""

    command: Array
    measurement: Array
    errors: tuple[float, ...]


def lifted_inverse(
    model: Model,
    reference: Annotated[Array, "N A"],
    *,
    sample_time: float | None = None,
    limits: tuple[ArrayLike, ArrayLike] | None = None,
    damping: float = 1e-4,
) -> LiftedInverse:
    """Command that makes the model, settled at the first command, follow a reference from its first to its last sample."""
    reference = np.ascontiguousarray(reference, dtype=float)
    axes = len(model.axes)
    if reference.ndim != 2 or reference.shape[1] != axes or len(reference) < 2 or not np.all(np.isfinite(reference)):
        raise InputError(
            f"reference: must be at least two rows of finite numbers, one column per axis, got shape {reference.shape}"
        )
    sample_time = float(sample_time or model.sample_time)
    bounds = drive_limits(model, limits)
    learn = _learning_filter(model, len(reference), sample_time, damping)
    slope, offset = mean_line(model, *bounds)
    command = np.clip((reference - offset) / slope, *bounds)
    measurement = simulate(model, command, sample_time, "zoh")
    errors = [_rms(reference - measurement)]
    bandwidth, failures = 10.0 / (len(reference) * sample_time), 0
    for _ in range(ITERATIONS):
        trial = np.clip(command + learn(reference - measurement, bandwidth), *bounds)
        answer = simulate(model, trial, sample_time, "zoh")
        error = _rms(reference - answer)
        settled = error > 0.9 * errors[-1]
        if error < errors[-1]:
            command, measurement, failures = trial, answer, 0
            errors.append(error)
        else:
            failures += 1
        if settled:
            bandwidth *= 1.5
        if failures == 4:
            break
    return LiftedInverse(command, measurement, tuple(errors))


def _learning_filter(model: Model, rows: int, sample_time: float, damping: float) -> Callable[[Array, float], Array]:
    """A function from an error (rows, A) to the command that the linearized model answers with it, in the least-squares sense."""
    axes = len(model.axes)
    # Twice the length: the circular convolution of the transform must not wrap the end of the record into its start.
    length = 2 * rows
    z = np.exp(2j * np.pi * np.arange(length // 2 + 1) / length)
    frequency = np.arange(length // 2 + 1) / (length * sample_time)
    response = sampled_response(linearized(model), axes, sample_time, z)
    adjoint = response.conj().transpose(0, 2, 1)
    weight = damping * np.abs(response).max() ** 2
    gain = np.linalg.solve(adjoint @ response + weight * np.eye(axes), adjoint)

    def learn(error: Array, bandwidth: float) -> Array:
        # The error is continued by its mirror image, which has no jump that the filter would ring on.
        spectrum = np.fft.rfft(np.concatenate([error, error[::-1]]), axis=0)
        # Full weight to two thirds of the bandwidth, none above four thirds, a cosine in between.
        share = 0.5 + 0.5 * np.cos(np.pi * np.clip(1.5 * frequency / bandwidth - 1.0, 0.0, 1.0))
        return np.fft.irfft(share[:, None] * np.einsum("fij,fj->fi", gain, spectrum), length, axis=0)[:rows]

    return learn


def _rms(error: Array) -> float:
    return float(np.sqrt(np.mean(error**2)))
