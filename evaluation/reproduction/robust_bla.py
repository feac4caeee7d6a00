# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Best linear approximation by the robust method (Pintelon & Schoukens, System Identification, 2nd edition, 2012, section 4.3.1)."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.identify.modal.frequency_response import FrequencyResponse, excited_lines


def robust_bla(
    command: Annotated[Array, "N m R P"], measurement: Annotated[Array, "N m R P"], sample_time: float
) -> FrequencyResponse:
    """Best linear approximation from periodic random-phase multisines, by the robust method (P&S, section 4.3.1).

    m neighboring realizations form a group whose command matrix is inverted per line, best conditioned for orthogonal multisines
    (Dobrowiecki, Schoukens, Guillaume, IEEE Trans. Instrum. Meas. 55 (2006) 1555-1566). The scatter over the periods is the noise, that
    over the groups noise and nonlinear distortion; with one group only the latter is unknown.
    """
    # command, measurement: (N, m, R, P) in V and (N, p, R, P): one period of N samples, R realizations, a multiple of the number of
    # inputs m, and P >= 2 steady periods
    n, m, realizations, periods = command.shape
    p = measurement.shape[1]
    if measurement.shape != (n, p, realizations, periods) or realizations % m or periods < 2:
        raise InputError(
            f"multisines: command {command.shape} and measurement {measurement.shape}: (samples, channels, "
            f"realizations, periods): must have a multiple of {m} realizations and at least 2 periods"
        )
    u = np.fft.rfft(command, axis=0) / n
    y = np.fft.rfft(measurement, axis=0) / n
    excited = excited_lines(np.sum(np.abs(u) ** 2, axis=(1, 2, 3)))
    u, y = u[excited], y[excited]
    groups = realizations // m
    per_group = np.empty((groups, len(excited), p, m), dtype=complex)
    noise = np.empty((groups, len(excited), p, m))
    for g in range(groups):
        chosen = slice(g * m, (g + 1) * m)
        inverse = np.linalg.inv(u[:, :, chosen].mean(axis=3))
        per_group[g] = y[:, :, chosen].mean(axis=3) @ inverse
        # The response to small differences of the command between periods is not noise.
        residual = y[:, :, chosen] - np.einsum("koj,kjrP->korP", per_group[g], u[:, :, chosen])
        power = np.sum(np.abs(residual) ** 2, axis=3) / (periods - 1) / periods
        noise[g] = power @ np.abs(inverse) ** 2
    noise_variance = noise.mean(axis=0) / groups
    total = None
    if groups > 1:
        total = np.sum(np.abs(per_group - per_group.mean(axis=0)) ** 2, axis=0) / (groups - 1) / groups
    return FrequencyResponse(excited / (n * sample_time), per_group.mean(axis=0), noise_variance, total, realizations)
