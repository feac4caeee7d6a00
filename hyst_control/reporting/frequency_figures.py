# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Bode plots: magnitude, phase and coherence of measured and of computed frequency responses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array, Complex
from hyst_control.base.errors import InputError
from hyst_control.records.averaged_spectra import Spectra, segment_length
from hyst_control.records.record import Record
from hyst_control.records.repeated_periods import period_of
from hyst_control.reporting.signal_figures import MAX_POINTS, Line, Panel

COHERENT = 0.5  # Coherence below which a measured response is not drawn: it is noise
MIN_POWER = 1e-9  # Of the command's strongest frequency, above which a response is shown
NEIGHBORS = 9  # Frequencies whose phases are taken together to make it continuous
FEWEST_PERIODS = 4  # Periods of a command that repeats from which each is a segment of its own, without leakage


@dataclass(frozen=True)
class Response:
    """Frequency response of one axis to its own command."""

    name: str
    frequency: Annotated[Array, "F"]  # Hz
    values: Annotated[Complex, "F"]  # Measurement unit per V
    coherence: Annotated[Array, "F"] | None = None  # Of a measured one


def measured_responses(record: Record) -> list[Response]:
    """Frequency response of every axis by averaged spectra, with the coherence, of the longest stretch without a gap."""
    part = max(record.aligned(allow_gaps=True), key=lambda each: len(each.time))
    command, measurement = part.command, part.measurement
    if command.shape != measurement.shape:
        raise InputError(f"{record.source}: command and measurement have not the same axes: record both of the same ones")
    period = period_of(command)
    repeats = period is not None and len(command) >= (FEWEST_PERIODS + 1) * period
    length = period if repeats and period is not None else segment_length(len(command))
    begin = length if repeats else 0  # what a record begins with is over after a period
    spectra = Spectra.of(command[begin:], measurement[begin:], length, repeats)
    frequency = np.arange(len(spectra.auto)) / (length * part.sample_time)
    found = []
    for index, axis in enumerate(part.axes):
        own, cross = spectra.auto[:, index, index].real, spectra.cross[:, index, index]
        known = own > MIN_POWER * own[1:].max()
        known[0] = False
        # Where the commands of the axes are one, none is told from the others: what is measured follows its own.
        alone = np.abs(cross) ** 2 / np.maximum(own * spectra.power[:, index], 1e-300)
        values = np.where(spectra.independent, spectra.transfer[:, index, index], cross / np.maximum(own, 1e-300))
        coherence = np.where(spectra.independent, spectra.coherence[:, index], alone)
        label = f"measured {axis}" if len(part.axes) > 1 else "measured"
        found.append(Response(label, frequency[known], values[known], coherence[known]))
    return found


def bode_of_record(record: Record) -> list[Panel]:
    """Bode plot of a record, with its coherence."""
    return bode(measured_responses(record), f"{record.signal('measurement').unit}/V")


def continuous_phase(values: Annotated[Complex, "F"]) -> Annotated[Array, "F"]:
    """Phase (rad) without jumps, around that of neighbors taken together: one that scatters by half a turn turns no other."""
    if not len(values):
        return np.zeros(0)
    directions = values / np.maximum(np.abs(values), 1e-300)
    width = NEIGHBORS if len(values) > 10 * NEIGHBORS else 1
    around = np.convolve(directions, np.ones(width), mode="same")
    return np.asarray(np.unwrap(np.angle(around)) + np.angle(directions * around.conj()))


def bode(responses: Sequence[Response], unit: str) -> list[Panel]:
    """Magnitude, phase and, where one was measured, coherence over frequency."""
    magnitude, phase, coherence = [], [], []
    for each in responses:
        sure = np.ones(len(each.frequency), bool) if each.coherence is None else each.coherence >= COHERENT
        step = max(1, len(each.frequency) // MAX_POINTS)
        x, values = each.frequency[sure][::step], each.values[sure][::step]
        dots = each.coherence is not None
        magnitude.append(Line(each.name, x, np.abs(values), dots))
        phase.append(Line(each.name, x, np.degrees(continuous_phase(values)), dots))
        if each.coherence is not None:
            coherence.append(Line(each.name, each.frequency[::step], each.coherence[::step], dots))
    panels = [
        Panel("frequency [Hz]", f"magnitude [{unit}]", tuple(magnitude), "xy"),
        Panel("frequency [Hz]", "phase [deg]", tuple(phase), "x"),
    ]
    return [*panels, Panel("frequency [Hz]", "coherence", tuple(coherence), "x", (0.0, 1.05))] if coherence else panels
