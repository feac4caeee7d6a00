# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Frequency responses, spectra and settling times of the MHL paper's signals."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np

from hyst_control.base.arrays import Array, Complex
from hyst_control.identify.data.dataset import Dataset
from hyst_control.model_file import Model, simulate
from hyst_control.reporting.tables import Table


def open_loop_responses(model: Model, data: Dataset, axis: int) -> tuple[Array, Complex, Complex]:
    """Compute measured and modeled responses by cross spectra of an axis' small sweep."""
    command = data.command[:, axis]
    own = slice(axis * len(command) // len(data.axes), (axis + 1) * len(command) // len(data.axes))
    moving = np.flatnonzero(np.abs(np.diff(command[own])) > 0)
    last = own.start + int(moving[-1]) - int(0.1 / data.sample_time)
    part = slice(last - int(1.0 / data.sample_time), last)
    found = []
    for y in (data.measurement, simulate(model, data.command, data.sample_time, data.hold)):
        frequency, value = cross_spectrum(command[part] - command[part].mean(), y[part, axis], data.sample_time)
        found.append(value)
    return frequency, found[0], found[1]


def cross_spectrum(u: Annotated[Array, "N"], y: Annotated[Array, "N"], sample_time: float) -> tuple[Array, Complex]:
    """Estimate a frequency response from 30 to 4000 Hz in 109 logarithmic bands."""
    window = np.hanning(len(u))
    spectra = [np.fft.rfft(window * (signal - signal.mean())) for signal in (u, y)]
    frequency = np.fft.rfftfreq(len(u), sample_time)
    edges = np.geomspace(30.0, 4000.0, 110)
    index = np.digitize(frequency, edges)
    cross, power = (
        np.array([values[index == band].sum() for band in range(1, len(edges))])
        for values in (spectra[1] * spectra[0].conj(), np.abs(spectra[0]) ** 2)
    )
    kept = power > 0
    return np.sqrt(edges[1:] * edges[:-1])[kept], (cross[kept] / power[kept])


def error_spectrum(
    table: Table,
    tracked: Mapping[str, Mapping[str, Array]],
    part: Any,
    sample_time: float,
    frequency: float = 100.0,
    highest: int = 10,
) -> None:
    """Add the composition of the single frequency's error, in % of the range: fundamental, harmonics and the rest."""
    for name, signals in tracked.items():
        wanted, actual = (signals[key][part.scored : part.end, 0] for key in ("reference", "measurement"))
        spectrum = np.fft.rfft(actual - wanted) / len(wanted)
        power = 2.0 * np.abs(spectrum) ** 2
        power[0] /= 2.0
        if len(wanted) % 2 == 0:
            power[-1] /= 2.0
        cycle = int(round(frequency * sample_time * len(wanted)))
        lines = {
            "mean": power[:1],
            "fundamental": power[cycle : cycle + 1],
            "second harmonic": power[2 * cycle : 2 * cycle + 1],
            "third harmonic": power[3 * cycle : 3 * cycle + 1],
            f"harmonics 4 to {highest}": power[4 * cycle : highest * cycle + 1 : cycle],
        }
        rest = power.sum() - sum(part.sum() for part in lines.values())
        for quantity, value in (*((key, each.sum()) for key, each in lines.items()), ("rest", max(rest, 0.0))):
            table.add(
                "MHL Table 4: the error at 100 Hz", "single", name, quantity, "%", 100.0 * float(np.sqrt(value) / np.ptp(wanted))
            )


def response(signals: Mapping[str, Array], part: Any, sample_time: float, period: float = 0.2) -> tuple[Array, Complex]:
    """Compute the response from reference to measurement of axis x, from the small multisine."""
    count = int(round(period / sample_time))
    r, y = (
        np.fft.rfft(signals[key][part.scored : part.end, 0].reshape(-1, count).mean(axis=0)) for key in ("reference", "measurement")
    )
    line = np.flatnonzero(np.abs(r) > 1e-3 * np.abs(r[1:]).max())
    line = line[line > 0]
    return line / period, y[line] / r[line]


def fundamental(signals: Mapping[str, Array], part: Any, sample_time: float, frequency: float) -> complex:
    """Compute measurement over reference of axis x at one frequency, over whole cycles."""
    rows = slice(part.scored, part.end)
    turn = np.exp(-2j * np.pi * frequency * sample_time * np.arange(part.end - part.scored))
    return complex((turn @ signals["measurement"][rows, 0]) / (turn @ signals["reference"][rows, 0]))


def bandwidth(frequency: Annotated[Array, "F"], value: Complex) -> float:
    """Find the first frequency at which the gain, as a mean of three neighboring lines, falls below -3 dB."""
    size = np.sqrt(np.convolve(np.abs(value) ** 2, np.ones(3) / 3.0, "valid"))
    below = np.flatnonzero(size < np.sqrt(0.5))
    return float(frequency[1:-1][below[0]]) if len(below) else float(frequency[-1])


def settling_time(signals: Mapping[str, Array], part: Any, sample_time: float) -> float:
    """Find the time after the step from which the measurement stays within 2 % of the step's height."""
    reference, measurement = (signals[key][part.begin : part.end, 0] for key in ("reference", "measurement"))
    height = reference[-1] - reference[0]
    start = int(np.flatnonzero(reference != reference[0])[0])
    outside = np.flatnonzero(np.abs(measurement[start:] - reference[-1]) > 0.02 * abs(height))
    return sample_time * float(outside[-1] + 1 if len(outside) else 0)
