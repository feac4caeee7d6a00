# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A measured frequency response as a record in time: the steady answer to sines of its frequencies, which identification can fit."""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from hyst_control.base.arrays import Array, Complex
from hyst_control.base.errors import InputError
from hyst_control.records.record import Record, Signal, axis_names
from hyst_control.records.tables.columns import Column
from hyst_control.records.tables.units import NAMES, unit_of

FREQUENCY_UNITS = {"Hz": 1.0, "kHz": 1e3, "rad/s": 0.5 / np.pi}
ANGLES = {"deg": np.pi / 180.0, "rad": 1.0, "mrad": 1e-3}

OVERSAMPLING = 10
"""Samples a period of the highest frequency: a straight line between them is a sine to 3 %, for which the answer is corrected."""

PERIODS = 10  # Periods of the lowest frequency in the record, fewer where it would be very long

MAX_SAMPLES = 2**21
MAX_COSINES = 2e8  # Samples times frequencies: of more frequencies some evenly spread ones are taken

MIN_COHERENCE = 0.5
COMMAND_RANGE = 10.0

_DECIBEL = re.compile(r"dB\s*\(?\s*(?:re\.?)?\s*(?P<ratio>[^()]*?)\s*\)?")


def response_record(source: str, columns: Sequence[Column], held: dict[str, Array]) -> Record:
    """The record that a frequency response (frequency, magnitude and phase, or real and imaginary part; coherence) stands for.

    The command is the sum of sines of the measured frequencies between whose samples it is straight ("foh"), larger where the response
    is small; the measurement is their steady answer. Several columns are axes, each of which answers its own command. Raises
    `InputError` where a column is missing or holds no such numbers.
    """
    given = {column.topic: column for column in columns}
    known = {name: np.hstack([held[each] for each in column.columns]) for name, column in given.items()}
    _check_widths(known)
    if {"magnitude", "phase"} <= set(given):
        size, units = _magnitude(known["magnitude"], given["magnitude"].unit)
        response = size * np.exp(1j * known["phase"] * _scale("phase", given["phase"].unit, ANGLES))
    elif {"real", "imaginary"} <= set(given):
        factor, units = _ratio(given["real"].unit)
        response = factor * (known["real"] + 1j * known["imaginary"])
    else:
        raise InputError("columns: a frequency response needs frequency, magnitude and phase, or frequency, real and imaginary")
    frequency = known["frequency"][:, 0] * _scale("frequency", given["frequency"].unit, FREQUENCY_UNITS)
    notes = []
    if given.get("magnitude", given["frequency"]).unit == "dB":
        notes.append(f"{source}: the magnitude in dB is taken as that of um/V: write another as [dB mrad/V]")
    usable = np.isfinite(frequency) & (frequency > 0.0) & (np.isfinite(response) & (response != 0.0)).all(axis=1)
    if "coherence" in known:
        usable &= (known["coherence"] >= MIN_COHERENCE).all(axis=1)
    if usable.sum() < 8:
        raise InputError(
            f"{source}: only {int(usable.sum())} frequencies have a finite response: a frequency response needs 8 at least"
        )
    if left := int(np.sum(~usable)):
        notes.append(f"{source}: {left} frequencies were left out: 0 Hz, no finite response, or a coherence below {MIN_COHERENCE}")
    frequency, first = np.unique(frequency[usable], return_index=True)
    response = response[usable][first]
    rate = OVERSAMPLING * float(frequency[-1])
    count = int(min(rate * PERIODS / float(frequency[0]), MAX_SAMPLES))
    if count < rate / float(frequency[0]):
        raise InputError(
            f"{source}: {frequency[0]:.4g} to {frequency[-1]:.4g} Hz are too many decades for one record: choose rows of fewer (--rows)"
        )
    most = max(int(MAX_COSINES / count), 8)
    if len(frequency) > most:
        chosen = np.unique(np.linspace(0, len(frequency) - 1, most).astype(int))
        notes.append(f"{source}: {len(chosen)} of {len(frequency)} frequencies were taken")
        frequency, response = frequency[chosen], response[chosen]
    generator = np.random.default_rng(0)  # other phases for each axis, so that no command is that of another
    steady = [_steady(frequency, answer, rate, count, generator) for answer in response.T]
    command, measurement = np.stack(steady, axis=2)
    alone = " --no-coupled" if len(steady) > 1 else ""
    notes.append(
        f"{source}: a frequency response is no record in time: written is the steady answer to {len(frequency)} sines of "
        f"{frequency[0]:.4g} to {frequency[-1]:.4g} Hz, for identify --model linear{alone}"
    )
    time = np.arange(count) / rate
    signals = {
        topic: Signal(time, np.ascontiguousarray(values), axis_names(len(steady)), unit)
        for topic, values, unit in (("command", command, units[1]), ("measurement", measurement, units[0]))
    }
    return Record(signals, source, tuple(notes), "foh", states_hold=True)


def _check_widths(known: dict[str, Array]) -> None:
    """Refuse several frequencies, and other columns that are not as many as the axes; one coherence may be that of all."""
    width = max(values.shape[1] for values in known.values())
    for topic, values in known.items():
        if values.shape[1] not in {"frequency": (1,), "coherence": (1, width)}.get(topic, (width,)):
            remedy = "name one" if topic == "frequency" else f"another has {width}: name one of each axis (magnitude=2+4[dB])"
            raise InputError(f"columns: {topic}: {values.shape[1]} columns: {remedy}")


def _steady(frequency: Array, response: Complex, rate: float, count: int, generator: np.random.Generator) -> tuple[Array, Array]:
    """Command and steady answer (N,) of sines at these frequencies, the command straight between samples."""
    straight = np.sinc(frequency / rate) ** 2  # what linear interpolation leaves of a sine
    size = 1.0 / np.sqrt(np.maximum(np.abs(response), 1e-6 * np.abs(response).max()))
    phase = generator.uniform(0.0, 2.0 * np.pi, len(frequency))
    command, measurement = np.zeros(count), np.zeros(count)
    ticks = np.arange(count) / rate
    for one, answer, amplitude, begin in zip(frequency, response * straight, size, phase, strict=True):
        angle = 2.0 * np.pi * one * ticks + begin
        command += amplitude * np.cos(angle)
        measurement += amplitude * np.abs(answer) * np.cos(angle + np.angle(answer))
    scale = COMMAND_RANGE / float(np.ptp(command))
    return scale * command, scale * measurement


def check_response_unit(topic: str, unit: str) -> None:
    """Raise `InputError` where a column of a frequency response may not be in this unit."""
    if topic in ("frequency", "phase"):
        _scale(topic, unit, FREQUENCY_UNITS if topic == "frequency" else ANGLES)
    elif topic == "magnitude":
        _magnitude(np.empty(0), unit)
    elif topic != "coherence":
        _ratio(unit)


def _scale(topic: str, unit: str, known: dict[str, float]) -> float:
    found = known.get(NAMES.get(unit.lower(), unit))
    if found is None:
        raise InputError(f"columns: {topic}: unit {unit!r} is not known, must be one of {', '.join(known)}")
    return found


def _magnitude(values: Array, unit: str) -> tuple[Array, tuple[str, str]]:
    """Sizes in measurement unit per command unit, and these two units."""
    decibel = _DECIBEL.fullmatch(unit)
    factor, units = _ratio((decibel["ratio"] or "um/V") if decibel else unit)
    return factor * (10.0 ** (values / 20.0) if decibel else values), units


def _ratio(text: str) -> tuple[float, tuple[str, str]]:
    """Factor and units of "nm/V": 1e-3, um and V."""
    upper, slash, lower = text.partition("/")
    above, below = unit_of(upper), unit_of(lower)
    if not slash or above is None or below is None:
        raise InputError(f"columns: unit {text!r} must be one of a response, such as um/V, nm/V, mrad/V, dB, or dB mrad/V")
    return above[1] / below[1], (above[0], below[0])
