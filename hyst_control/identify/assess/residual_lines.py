# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Lines in what a model leaves that no line of the command makes, such as mains hum: steady in time, at no frequency of the command."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array, Complex
from hyst_control.records.record import Record
from hyst_control.records.session_zero import without_zero

ROWS, MIN_ROWS = 2**16, 1024  # First rows of a record that are looked at, and too few to find a line in
SECTIONS, STEADY = 8, 0.8
"""Sections of a record, and the share of their power that one steady sine has: ringing begins anew, and motion changes its phase."""
STRONG, LARGE = 0.05, 1e-3  # Least share of the error's power, and least amplitude in the range, that are reported
PROMINENT, BESIDE = 100.0, (4, 12)  # Ratio of a line's power and that of the bins beside it, so many away
PEAKS = 5  # Largest peaks that are tried
COMMAND_LINES, HARMONICS, NEAR, LOBE = 20, 3, 0.5, 1.5
"""Largest lines of a command whose harmonics and their sums and differences are its own, the bins by which two frequencies differ, and
those by which what is left differs from a line that swells."""
MAINS, OFF_MAINS = (50.0, 60.0), 0.01  # Frequencies of the mains, Hz, and the share by which they vary


@dataclass(frozen=True)
class Line:
    """A steady sine."""

    frequency: float  # Hz
    amplitude: float  # Measurement unit


def line_notes(records: Sequence[Record], errors: Sequence[Annotated[Array, "N A"]]) -> list[str]:
    """The largest line of each record and axis that the command does not make, as notes."""
    return [
        f"{data.name}: {_in_words(name, line, data.unit, float(data.span[axis]))}"
        for data, error in zip(records, errors, strict=True)
        for axis, name in enumerate(data.axes)
        if (line := foreign_line(data, error, axis)) is not None
    ]


def _in_words(axis: str, line: Line, unit: str, span: float) -> str:
    harmonic = any(abs(line.frequency / mains - round(line.frequency / mains)) < OFF_MAINS for mains in MAINS)
    what = "hum" if harmonic and line.frequency > 0.5 * min(MAINS) else "a vibration or an interference"
    return (
        f"{axis}: {what} of {line.frequency:.4g} Hz, {line.amplitude:.2g} {unit} ({100.0 * line.amplitude / span:.2g} % of the range), "
        "is left, which the command does not make: check grounding, shielding and supports"
    )


def foreign_line(data: Record, error: Annotated[Array, "N A"], axis: int) -> Line | None:
    """The largest steady line of an error, of the last N rows of a record, that no line of the commands makes."""
    command = data.command[len(data.command) - len(error) :][:ROWS]
    error, count, span = error[:ROWS, [axis]], min(len(error), ROWS), float(data.span[axis])
    if count < MIN_ROWS or not span > 0.0:
        return None
    rest = without_zero(error)[0][:, 0]
    least = max(LARGE * span, float(np.sqrt(2.0 * STRONG * np.mean(rest**2))))
    for peak in _peaks(rest)[:PEAKS]:
        frequency, sections = _steady_sine(rest, peak)
        amplitude = abs(np.mean(sections))
        steady = amplitude**2 > STEADY * np.mean(np.abs(sections) ** 2)
        if steady and amplitude > least and not _made_by(command, frequency):
            return Line(frequency / (count * data.sample_time), float(amplitude))
    return None


def _peaks(values: Array) -> Array:
    """Bins of the prominent peaks of a spectrum, to a fraction, the largest first."""
    power = np.abs(np.fft.rfft((values - values.mean()) * np.hanning(len(values)))) ** 2
    near, far = BESIDE
    bins = 1 + np.flatnonzero((power[1:-1] > power[:-2]) & (power[1:-1] >= power[2:]))
    bins = bins[(bins >= SECTIONS) & (bins < len(power) - far)]
    bins = bins[np.argsort(power[bins])[::-1][: 4 * COMMAND_LINES]]
    beside = np.concatenate([np.arange(-far, 1 - near), np.arange(near, far + 1)])
    bins = bins[power[bins] > PROMINENT * np.median(power[np.maximum(bins[:, None] + beside, 0)], axis=1)]
    left, top, right = (np.log(np.maximum(power[bins + shift], 1e-300)) for shift in (-1, 0, 1))
    return np.asarray(bins + 0.5 * (left - right) / np.minimum(left - 2.0 * top + right, -1e-9))


def _steady_sine(values: Array, frequency: float) -> tuple[float, Complex]:
    """Frequency in bins, refined by how the phase goes on, and the complex amplitudes of the sine in each section."""
    length = len(values) // SECTIONS
    window = np.hanning(length) / np.sum(np.hanning(length))
    turns = np.exp(-2j * np.pi * frequency / len(values) * np.arange(SECTIONS * length)).reshape(SECTIONS, length)
    found = 2.0 * (values[: SECTIONS * length].reshape(SECTIONS, length) * turns) @ window
    late = float(np.angle(np.sum(found[1:] * found[:-1].conj())))
    return frequency + late * len(values) / (2.0 * np.pi * length), found * np.exp(-1j * late * np.arange(SECTIONS))


def _made_by(command: Annotated[Array, "N C"], frequency: float) -> bool:
    """True of a frequency, in bins, that is a sum or a difference of harmonics of the commands' lines."""
    lines = np.concatenate([_peaks(values)[:COMMAND_LINES] for values in command.T if np.ptp(values) > 0.0] or [np.zeros(0)])
    if np.any(np.abs(lines - frequency) < LOBE):
        return True
    several = np.concatenate([[0.0], *(order * lines for order in range(1, HARMONICS + 1))])
    sums = (np.abs(one + sign * other) for one, (sign, other) in product(several, product((1.0, -1.0), [several])))
    return any(np.any(np.abs(each - frequency) < NEAR) for each in sums)
