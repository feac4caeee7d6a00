# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Motion at rest with feedback, predicted from a record of it without feedback: S = 1 / (1 + L) by frequency."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.fft import rfft

from hyst_control.base.arrays import Array, Complex
from hyst_control.base.errors import InputError
from hyst_control.chain import Stage
from hyst_control.control.linearization import hysteresis_slopes, linearized, sampled_response
from hyst_control.control.tuning import Tuning, controller_response
from hyst_control.model_file import Model
from hyst_control.records.record import Record
from hyst_control.reporting.tables import Table

SEGMENTS, LONGEST = 4, 1 << 16
"""Windows that fit into the record one after the other, and their greatest length in samples; each overlaps the next by half."""
COMMANDED = 0.1
"""Share of the motion that the command may cause and still count as resting: a measured drive voltage is noisy."""


@dataclass(frozen=True)
class Jitter:
    """Rms of a stage's motion at rest, by decades of frequency, without and with a feedback.

    Parameters
    ----------
    edges
        Lower end of each band, Hz, and the upper end of the last (B + 1,).
    without, closed
        Rms (B, A) in the measurement's unit, without and with the feedback.
    axes, unit
        Names of the axes, and that unit.
    notes
        Sentences on what the figures do not include.
    """

    edges: Array
    without: Array
    closed: Array
    axes: tuple[str, ...]
    unit: str
    notes: tuple[str, ...] = ()

    def add_to(self, table: Table) -> None:
        """Append the rms of each axis, in all and by band, to a table."""
        for axis, name in enumerate(self.axes):
            for subject, rms in (("without feedback", self.without[:, axis]), ("with feedback", self.closed[:, axis])):
                table.add("jitter", name, subject, "rms", self.unit, np.sqrt(np.sum(rms**2)))
                for low, high, value in zip(self.edges[:-1], self.edges[1:], rms, strict=True):
                    table.add("jitter", f"{name}, {low:.4g} to {high:.4g} Hz", subject, "rms", self.unit, value)
        table.notes += self.notes


def jitter(tuning: Tuning, model: Model, record: Record, loop_delay: int = 0) -> Jitter:
    """Predict the motion at rest with feedback from a record without: vibrations of the table, wander of a beam, noise of the drive.

    Parameters
    ----------
    tuning
        The feedback.
    model
        Model of the stage; the hysteresis has its mean slope.
    record
        Record of the measurement while the command rests, without feedback.
    loop_delay
        Further delay of the loop, ticks.

    Returns
    -------
    Jitter
        Rms by decades of frequency.

    Raises
    ------
    InputError
        The command moves, the record is too short, or its axes or unit are not the model's.
    """
    unit, command = model.units["measurement"], record.signals.get("command")
    measurement = record.signal("measurement")
    if (measurement.unit, len(measurement.axes)) != (unit, len(model.axes)):
        raise InputError(
            f"{record.source}: has {len(measurement.axes)} axes in {measurement.unit}, {model.name} {len(model.axes)} in {unit}"
        )
    stages = linearized(model, hysteresis_slopes(model)[0])
    if command is not None:
        answer = np.abs(sampled_response(stages, len(model.axes), tuning.sample_time, np.array([np.exp(1e-6j)]))[0])
        if np.any(answer @ np.std(command.values, axis=0) > COMMANDED * np.std(measurement.values, axis=0)):
            raise InputError(f"{record.source}: the command moves: record the jitter while it rests, without feedback")
    (data,) = record.aligned(("measurement",))
    rows, step = data.measurement - data.measurement.mean(axis=0), data.sample_time
    length = min(len(rows) // SEGMENTS, LONGEST)
    if length < 16:
        raise InputError(f"{record.source}: {len(rows)} samples show no spectrum: record longer")
    window = np.hanning(length + 1)[:-1]
    frequency = np.asarray(np.fft.rfftfreq(length, step)[1:], dtype=np.float64)
    left = _sensitivity(tuning, stages, len(model.axes), loop_delay, frequency)
    before, after = np.zeros((2, len(frequency), len(model.axes)))
    segments = sliding_window_view(rows, length, axis=0)[:: length - length // 2]
    for segment in segments:
        moved = rfft(segment * window, axis=-1)[:, 1:].T
        before += np.abs(moved) ** 2
        after += np.abs(np.einsum("fij,fj->fi", left, moved)) ** 2
    scale = 2.0 / (length * np.sum(window**2) * len(segments))  # both halves of the spectrum
    decades = 10.0 ** np.arange(np.ceil(np.log10(frequency[0]) + 1e-9), np.log10(frequency[-1]) - 1e-9)
    edges = np.unique([frequency[0], *decades, frequency[-1]])
    starts = np.searchsorted(frequency, edges[:-1])
    rms = [np.sqrt(scale * np.add.reduceat(power, starts, axis=0)) for power in (before, after)]
    notes = [
        "Jitter: noise of the sensor counts as motion here. The loop also makes the stage follow that noise, which is not included."
    ]
    if frequency[-1] * tuning.sample_time > 0.5 * (1.0 + 1e-6):
        notes.append(
            f"Jitter: above {0.5 / tuning.sample_time:g} Hz, half the loop's rate, motion is unchanged; its alias is not included."
        )
    return Jitter(edges, rms[0], rms[1], model.axes, unit, tuple(notes))


def _sensitivity(tuning: Tuning, stages: Sequence[Stage], axes: int, loop_delay: int, frequency: Array) -> Complex:
    """S (F, A, A) of the sampled loop; above half its rate, 1."""
    below = frequency * tuning.sample_time < 0.5 * (1.0 + 1e-6)
    z = np.exp(2j * np.pi * frequency[below] * tuning.sample_time)
    loop = (
        sampled_response(stages, axes, tuning.sample_time, z) * (controller_response(tuning.law, z) * z**-loop_delay)[:, None, None]
    )
    found = np.tile(np.eye(axes, dtype=complex), (len(frequency), 1, 1))
    found[below] = np.linalg.inv(np.eye(axes) + loop)
    return found
