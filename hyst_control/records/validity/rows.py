# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Rows of a record to which reference models are fitted, and limits that several checks share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.records.stream.row_store import blocks
from hyst_control.records.validity.facts import interpolated
from hyst_control.records.validity.findings import Trial
from hyst_control.records.validity.reference_model import condensed

SOUND = 1e-4  # Share of a measurement's power that models of moderate order leave of many sound records

CLEAR, CLEAR_LEAD, CLEAR_EXCHANGE = 2.0, 4.0, 1.5
"""Ratio of the powers that a model leaves of a record, and of the record read backwards, shifted, and exchanged, from which it is that.

Of sound records of many sines the ratios stay below 1; a model is never its machine, so a verdict needs more than that. Where the
measurement is not the cleaner of the two, noise alone makes an exchange look better, up to `CLEAR_LEAD`.
"""

MIN_SINES, MANY_SINES = 9.0, 70.0
"""Sines in a command from which a record tells one causal model from another, since with fewer the poles of a model fit any phases; and
from which there are more than coefficients, so that a model may leave a good part of the power."""

HALF = 0.5
"""Share of a measurement's power that initial states alone must leave of a sound record, and that an arrangement may leave at most."""

SATURATION_MATTERS = 1e-3
"""Share of a measurement's power that a model leaves from which it is asked whether the command stops acting."""

MAX_PAIRED = 4  # Axes up to which every order is tried, and commands up to which an axis may be driven by all of them


@dataclass(frozen=True)
class CondensedRows:
    """The rows of a trial that models are fitted to, of `together` samples each."""

    command: Array
    measurement: Array
    simulated: Array | None
    together: int

    @classmethod
    def of(cls, trial: Trial) -> CondensedRows:
        """Rows of a trial; a command that was logged too rarely is interpolated."""
        command = np.column_stack([interpolated(values) for values in trial.command.T])
        width = len(trial.axes)
        both = trial.measurement if trial.simulated is None else np.hstack([trial.measurement, trial.simulated])
        rows, measured, together = condensed(command, both)
        return cls(rows, measured[:, :width], None if trial.simulated is None else measured[:, width:], together)

    def fastest(self, trial: Trial) -> CondensedRows:
        """As many rows of the trial as they are, where its commands move fastest."""
        rows = fastest_rows(trial.command, len(self.command))
        return CondensedRows(trial.command[rows], trial.measurement[rows], None, 1)

    def inputs(self, index: int) -> Array:
        """Commands that may drive an axis."""
        return self.command if self.command.shape[1] <= MAX_PAIRED else self.command[:, [index]]


def fastest_rows(command: Array, count: int) -> slice:
    """So many rows of commands (N, A), where they move fastest."""
    power = np.zeros(len(command))
    for part in blocks(len(power) - 1):
        power[part.start + 1 : part.stop + 1] = np.sum(np.diff(command[part.start : part.stop + 1], axis=0) ** 2, axis=1)
    np.cumsum(power, out=power)
    begin = int(np.argmax(power[count - 1 :] - power[: len(power) - count + 1])) if count < len(power) else 0
    return slice(begin, begin + count)
