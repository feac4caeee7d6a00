# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The noise floor: what no simulator can explain, from the record and never from a candidate's own residual."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.diagnose.configuration import CONFIGURATION, NoiseSettings
from hyst_control.records.repeated_periods import period_of
from hyst_control.records.session_zero import without_zero


def noise_of(
    residuals: Sequence[Array], commands: Sequence[Array] | None = None, settings: NoiseSettings = CONFIGURATION.noise
) -> float:
    """White noise in residuals, from the upper part of their spectrum, the median over it.

    Where the command rests long enough and the noise is clearly less there, that counts: in motion the gap itself reaches up.
    """
    found = [_upper(residuals, settings.band)]
    if commands is not None:
        rests = [
            residual[a:b] for residual, command in zip(residuals, commands, strict=True) for a, b in resting(command, settings)
        ]
        if sum(map(len, rests)) >= 2 * settings.rest_samples:
            found.append(_upper(rests, settings.band))
    return found[-1] if found[-1] < settings.rests_below * found[0] else found[0]


def noise_between_periods(rows: Sequence[Array], commands: Sequence[Array], settings: NoiseSettings = CONFIGURATION.noise) -> float:
    """Noise by what records of a periodic command differ by between its periods: all that follows the command cancels.

    Of each record two stretches are compared that are as many periods long as it holds twice, without zero, drift and curvature. What
    is slow otherwise, or does not settle within them, makes it too large, never too small.
    """
    differences = []
    for values, command in zip(rows, commands, strict=True):
        period = period_of(command)
        if period is None:
            return np.inf
        length = period * (len(values) // (2 * period))
        later, earlier = values[length : 2 * length], values[:length]
        if length < settings.rest_samples or np.mean(later == earlier) > settings.copied_share:
            return np.inf
        differences.append(without_zero((later - earlier)[:, None])[0] / np.sqrt(2.0))
    return float(np.sqrt(np.mean(np.concatenate(differences) ** 2))) if differences else np.inf


def resting(command: Annotated[Array, "N"], settings: NoiseSettings = CONFIGURATION.noise) -> list[tuple[int, int]]:
    """Stretches of a constant command, without their first part, which still settles."""
    still = np.concatenate([[False], np.diff(command) == 0.0, [False]])
    edges = np.flatnonzero(np.diff(still.astype(int)))
    found = []
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        begin += (end - begin) // settings.rest_part
        if end - begin >= settings.rest_samples:
            found.append((int(begin), int(end)))
    return found


def _upper(residuals: Sequence[Array], band: tuple[float, float]) -> float:
    """Noise (rms) from first differences, weighted back, so that what is slow does not leak."""
    powers = []
    for residual in residuals:
        window = np.hanning(len(residual) - 1)
        spectrum = np.abs(np.fft.rfft(np.diff(residual) * window)) ** 2
        count = len(spectrum)
        frequency = np.arange(count) * np.pi / max(count - 1, 1)
        upper = slice(int(band[0] * count), int(band[1] * count))
        powers.append(spectrum[upper] / (4.0 * np.sin(0.5 * frequency[upper]) ** 2) / np.sum(window**2))
    # The median of an exponential distribution is ln 2 of its mean.
    return float(np.sqrt(np.median(np.concatenate(powers)) / np.log(2.0)))
