# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Noise that falls with frequency: flicker noise in a residual, separated from what follows the command."""

from __future__ import annotations

from functools import partial
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from hyst_control.base.arrays import Array, Mask
from hyst_control.base.signals import low_passed
from hyst_control.base.simplex import lowest
from hyst_control.diagnose.configuration import CONFIGURATION, FlickerSettings
from hyst_control.diagnose.evidence import FlickerEvidence
from hyst_control.records.repeated_periods import period_of

LINE_BINS = 1.5  # Bins to either side of a line that Hann's window spreads it over
NORMAL_MEDIAN = 0.6745  # Median of a normal variable's size
MIN_APART = 4.0  # Bins between lines from which those in between tell the noise


def flicker(
    residual: Annotated[Array, "N"], command: Annotated[Array, "N"], settings: FlickerSettings = CONFIGURATION.flicker
) -> FlickerEvidence:
    """Fit a + b/f^p to the periodogram of a residual by Whittle's likelihood over bands; a the white part, b the flicker.

    Every band counts with its median, which few lines in it do not move; where the command repeats, bins at its harmonics are left out.
    """
    count = len(residual)
    k = np.arange(2, count // 2)
    k = k[~_at_harmonics(k, command)]
    power = np.abs(np.fft.rfft(residual * np.sqrt(8.0 / 3.0) * np.hanning(count))[k]) ** 2 / count
    edges = np.unique(np.rint(2.0 ** np.arange(1.0, np.log2(k[-1]), 1.0 / settings.bands_per_octave)).astype(int))
    places = np.searchsorted(k, edges)
    bands = [(int(a), int(b)) for a, b in zip(places[:-1], places[1:], strict=True) if b - a >= 3]
    level = np.array([np.median(power[a:b]) / np.log(2.0) for a, b in bands])
    bins = np.array([b - a for a, b in bands], dtype=float) * np.log(2.0) ** 2  # a median knows less than a mean

    def misfit(logs: Array, falling: Array) -> float:
        spectrum = np.exp(logs[0]) + np.exp(logs[1]) * falling
        return float(np.sum(bins * (np.log(spectrum) + level / spectrum)))

    white = float(np.median(level[-settings.bands_per_octave :]))
    mean = float(bins @ level / bins.sum())
    alone = float(np.sum(bins * (np.log(mean) + level / mean)))
    fits: list[tuple[tuple[Array, float], float, Array]] = []
    for exponent in settings.exponents:
        falling = np.array([np.mean(k[a:b] ** -exponent) for a, b in bands])
        for start in (1e-1, 1e2):
            first = np.log([white, white * start])
            simplex = np.vstack([first, first, first])
            simplex[[1, 2], [0, 1]] = np.where(first, 1.05 * first, 0.00025)
            fits.append((lowest(partial(misfit, falling=falling), simplex, 1e-3, 1e-3), exponent, falling))

    def has_shape(item: tuple[tuple[Array, float], float, Array]) -> bool:
        a, b = np.exp(item[0][0])
        spectrum = a + b * item[2]
        colored = b * item[2] / spectrum > settings.colored_share
        # A band of three bins is off by twice as much by chance as the shape may be: it says little of the shape.
        scatter = np.log(level / spectrum)[colored] ** 2 / (settings.shape_misfit**2 + 1.0 / bins[colored])
        return bool(colored.sum() >= settings.min_bands and np.mean(scatter) < 1.0)

    # The usual exponent stands first: another one has to explain clearly more, or have the shape that the usual one has not.
    usual, other = (min(some, key=lambda item: item[0][1]) for some in (fits[:2], fits))
    nearly = usual[0][1] - settings.exponent_margin <= other[0][1]
    best, exponent, inverse = usual if nearly and (has_shape(usual) or not has_shape(other)) else other
    a, b = np.exp(best[0])
    rms = float(np.sqrt(2.0 * b * float(np.sum(np.arange(1, count // 2) ** -exponent)) / count))
    share = b * inverse / (a + b * inverse)
    spread = min(1.645 * 0.5 / np.sqrt(max(float(np.sum(bins * share**2)), 1e-9)), 3.0)
    return FlickerEvidence(
        rms,
        (rms * float(np.exp(-spread)), rms * float(np.exp(spread))),
        float(np.sqrt(a)),
        alone - best[1],
        has_shape((best, exponent, inverse)) and not _jumps(residual, settings) and _stationary(residual, command, settings),
        float(share[-1]),
    )


def _at_harmonics(k: NDArray[np.int_], command: Array) -> Mask:
    """True for bins (K,) of the window's lines at the harmonics of a command that repeats often enough for bins in between."""
    period = period_of(command[:, None])
    apart = len(command) / period if period is not None else 0.0
    if apart < MIN_APART:
        return np.zeros(len(k), dtype=bool)
    return np.asarray(np.abs(k - np.rint(k / apart) * apart) < LINE_BINS, dtype=bool)


def _jumps(residual: Array, settings: FlickerSettings) -> bool:
    """True where a residual steps further from sample to sample than normal noise does: something is switched."""
    steps = np.abs(np.diff(residual))
    usual = float(np.median(steps)) / NORMAL_MEDIAN
    return bool(np.count_nonzero(steps > settings.jump * usual) > settings.few_jumps) if usual > 0 else False


def _stationary(residual: Array, command: Array, settings: FlickerSettings) -> bool:
    slow = low_passed(residual, settings.slow_corner)
    length = max(len(residual) // settings.segments, 1)
    begins = range(0, len(residual) - length + 1, length)
    energy = np.array([np.var(slow[a : a + length]) for a in begins])
    activity = np.array([np.mean(np.abs(np.diff(command[a : a + length]))) for a in begins])
    order = np.argsort(activity)
    third = max(len(order) // 3, 1)
    quiet, busy = np.median(energy[order[:third]]), np.median(energy[order[-third:]])
    return bool(busy < settings.motion_ratio * quiet)
