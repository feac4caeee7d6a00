# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A mode and a pair of zeros next to it, a notch that misses its mode: where to look for the two, and a start that holds both.

Neither alone lowers the error of a model that lacks them, so that growing factor by factor never finds them. They begin upon each
other, where they change nothing, and part while they are fitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hyst_control.base.arrays import Array
from hyst_control.identify.solve.stable_dynamics import Structure

PAIR_DAMPINGS = (0.05, 0.2)  # Of a mode and the zeros upon it, from which the two are parted
SEGMENTS = 2**10  # Segments of spectra that are worked on at a time
WORTHWHILE = 0.01  # A factor of G is kept when it lowers the held-out mean square error by more than this share


def unexplained_frequency(
    signals: Sequence[tuple[Array, Array]], sample_time: float, length: int = 500, least: int = 20
) -> float | None:
    """Frequency (Hz) at which commands explain most of the errors that a model leaves; None without a long record."""
    window = np.hanning(length)
    explained = np.zeros(length // 2 + 1)
    for signal in signals:
        if len(signal[0]) < 2 * length:
            continue
        power, cross = np.zeros(len(explained)), np.zeros(len(explained), complex)
        segments = [np.lib.stride_tricks.sliding_window_view(values, length)[:: length // 2] for values in signal]
        for begin in range(0, len(segments[0]), SEGMENTS):
            parts = [rows[begin : begin + SEGMENTS] for rows in segments]
            u, e = (np.fft.rfft(window * (rows - rows.mean(axis=1, keepdims=True))) for rows in parts)
            power += np.sum(np.abs(u) ** 2, axis=0)
            cross += np.sum(e * u.conj(), axis=0)
        explained = np.maximum(explained, np.abs(cross) ** 2 / np.maximum(power, 1e-12 * power.max() + 1e-300))
    explained[: len(explained) // least] = 0.0
    line = int(np.argmax(explained[:-1]))
    return line / (length * sample_time) if explained[line] > 0.0 else None


def pole_zero_pair(smaller: Structure, dynamics: Array, frequency: float, damping: float) -> tuple[Structure, Array]:
    """Structure with a further mode and zeros upon it, and its dynamics vector: the same response as before until the two part."""
    structure = replace(smaller, modes=smaller.modes + 1, zeros=smaller.zeros + 2)
    parts = structure.split(structure.grow(smaller, dynamics, frequency))
    w = 2 * np.pi * frequency
    parts["modes"][-1] = np.log(w), np.log(damping)
    return structure, with_numerator(parts, np.polymul(smaller.numerator(dynamics), [1 / w**2, 2 * damping / w, 1.0]))


def with_numerator(parts: dict[str, Array], num: NDArray[np.floating[Any]]) -> Array:
    """Dynamics vector from its factors, with the zeros' coefficients taken from a numerator."""
    scale = np.exp(np.concatenate([parts["modes"][:, 0], parts["lags"]])).min()
    rising = (num / num[-1])[::-1]
    parts["zeros"][:] = 0.0
    parts["zeros"][: len(rising) - 1] = rising[1:] * scale ** np.arange(1, len(rising))
    return np.concatenate([part.ravel() for part in parts.values()])
