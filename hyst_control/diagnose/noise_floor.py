"""The noise floor: what no simulator can explain, from the record and never from a candidate's own residual."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hyst_control.chain.stage import Array

LEAKED = 0.85
"""Share of the whole record's estimate below which that of the rests is believed instead: they are short, and know less."""

REST = 400
"""Fewest samples of a rest that is long enough for a spectrum."""


def noise_of(residuals: Sequence[Array], commands: Sequence[Array] | None = None) -> float:
    """Rms of the white noise in residuals (N,), from the upper part of their spectrum, the median over it.

    Where the commands (N,) rest long enough and it is clearly less there, that counts: in motion the gap itself reaches up.
    """
    found = [_upper(residuals)]
    if commands is not None:
        rests = [residual[a:b] for residual, command in zip(residuals, commands, strict=True) for a, b in resting(command)]
        if sum(map(len, rests)) >= 2 * REST:
            found.append(_upper(rests))
    return found[-1] if found[-1] < LEAKED * found[0] else found[0]


def resting(command: Array) -> list[tuple[int, int]]:
    """Stretches (from, to) of at least `REST` samples of a constant command, without the first third, which still settles."""
    still = np.concatenate([[False], np.diff(command) == 0.0, [False]])
    edges = np.flatnonzero(np.diff(still.astype(int)))
    found = []
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        begin += (end - begin) // 3
        if end - begin >= REST:
            found.append((int(begin), int(end)))
    return found


def _upper(residuals: Sequence[Array]) -> float:
    """From first differences, weighted back, so that what is slow does not leak."""
    powers = []
    for residual in residuals:
        window = np.hanning(len(residual) - 1)
        spectrum = np.abs(np.fft.rfft(np.diff(residual) * window)) ** 2
        count = len(spectrum)
        frequency = np.arange(count) * np.pi / max(count - 1, 1)
        upper = slice(int(0.6 * count), int(0.98 * count))
        powers.append(spectrum[upper] / (4.0 * np.sin(0.5 * frequency[upper]) ** 2) / np.sum(window**2))
    # The median of an exponential distribution is ln 2 of its mean.
    return float(np.sqrt(np.median(np.concatenate(powers)) / np.log(2.0)))
