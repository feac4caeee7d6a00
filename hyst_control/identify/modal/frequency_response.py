# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Nonparametric frequency responses with their uncertainty.

P&S stands for Pintelon & Schoukens, System Identification: A Frequency Domain Approach, 2nd edition, Wiley-IEEE Press
2012.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError

EXCITED = 1e-3  # A line is excited when the command's power there exceeds this fraction of the mean power per line


@dataclass(frozen=True)
class FrequencyResponse:
    """A measured frequency response matrix, sample to sample: measurement = response · command, line by line."""

    frequency: Annotated[Array, "F"]  # Frequencies (F,), Hz
    response: np.ndarray  # Response (F, p, m), measurement unit per V
    noise_variance: Annotated[Array, "F p m"]  # Variance E|G - E G|² of the response because of disturbing noise

    def radius(self, confidence: float = 0.95) -> Annotated[Array, "F p m"]:
        """Radius of the circle in the complex plane that holds the true value with a given probability.

        The estimate is circular complex normal, so |G - E G|² / variance · 2 is chi-square with two degrees of freedom (P&S 2.4).
        """
        from scipy.stats import chi2  # here, not above: it takes longer to import than all that a node needs

        radius: Array = np.sqrt(self.noise_variance * chi2.ppf(confidence, 2) / 2.0)
        return radius


def local_polynomial(
    commands: Sequence[Array],
    measurements: Sequence[Array],
    sample_time: float,
    *,
    kind: str = "arbitrary",
    half_width: int | None = None,
    degree: int = 2,
    highest: float | None = None,
) -> FrequencyResponse:
    """Frequency response by the local polynomial method (P&S, sections 7.2.2 and 7.3.2).

    In a window of 2 `half_width` + 1 lines the response, and each record's transient, is a polynomial in the line number; what the
    polynomials leave is the noise.
    """
    # kind: "arbitrary": a transient at both ends is estimated along (the command's spectrum must be rough, as a random or a swept
    # one is); "periodic": whole periods in steady state, no transient
    if kind not in ("arbitrary", "periodic"):
        raise InputError(f"kind: must be arbitrary or periodic, got {kind!r}")
    u, y = np.stack(commands, axis=2), np.stack(measurements, axis=2)
    n, m, records = u.shape
    spectrum_u, spectrum_y = np.fft.rfft(u, axis=0) / np.sqrt(n), np.fft.rfft(y, axis=0) / np.sqrt(n)
    lines: NDArray[np.intp] = np.arange(1, len(spectrum_u))
    if kind == "periodic":
        lines = excited_lines(np.sum(np.abs(spectrum_u) ** 2, axis=(1, 2)))
    if highest is not None:
        lines = lines[lines <= highest * n * sample_time]
    frequency, spectrum_u, spectrum_y = lines / (n * sample_time), spectrum_u[lines], spectrum_y[lines]
    unknowns = (degree + 1) * (m + (records if kind == "arbitrary" else 0))
    if half_width is None:
        half_width = int(np.ceil((1.5 * unknowns + 4) / records / 2))
    width = 2 * half_width + 1
    if width * records <= unknowns or len(frequency) < width:
        raise InputError(
            f"local polynomial: {min(width, len(frequency))} lines of {records} records for {unknowns} unknowns: "
            "use longer records, a wider window or a lower degree"
        )
    response = np.empty((len(frequency), spectrum_y.shape[1], m), dtype=complex)
    variance = np.empty(response.shape)
    for k in range(len(frequency)):
        begin = min(max(k - half_width, 0), len(frequency) - width)
        window = slice(begin, begin + width)
        # The line number scaled to the window, so that the columns are of one size; at the line itself the offset is
        # zero.
        powers = ((np.arange(begin, begin + width) - k) / half_width)[:, None] ** np.arange(degree + 1)
        regressor = np.einsum("kjr,kd->krdj", spectrum_u[window], powers).reshape(width * records, -1)
        if kind == "arbitrary":
            transient = np.einsum("kd,rq->krdq", powers, np.eye(records)).reshape(width * records, -1)
            regressor = np.hstack([regressor, transient])
        target = np.swapaxes(spectrum_y[window], 1, 2).reshape(width * records, -1)
        scale = np.maximum(np.linalg.norm(regressor, axis=0), 1e-300)
        q, r = np.linalg.qr(regressor / scale)
        diagonal = np.abs(np.diag(r))
        if diagonal.min() < 1e-10 * diagonal.max():
            raise InputError(
                f"local polynomial: at {frequency[k]:g} Hz the records do not separate the {m} inputs: "
                "excite them differently, or take a command with a rougher spectrum"
            )
        inverse = np.linalg.inv(r) / scale[:, None]
        projected = q.conj().T @ target
        response[k] = (inverse @ projected)[:m].T
        noise = np.sum(np.abs(target - q @ projected) ** 2, axis=0) / (width * records - unknowns)
        variance[k] = np.outer(noise, np.sum(np.abs(inverse[:m]) ** 2, axis=1))
    return FrequencyResponse(frequency, response, variance)


def excited_lines(power: Annotated[Array, "F"]) -> NDArray[np.intp]:
    """Select the lines whose power exceeds `EXCITED` times the mean, except the static line."""
    chosen = np.flatnonzero(power > EXCITED * power[1:].mean())
    return chosen[chosen > 0]
