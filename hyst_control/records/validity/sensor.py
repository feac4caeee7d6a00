# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A sensor that keeps one value, or stands still while the command moves."""

from __future__ import annotations

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.records.quantization_step import quantization_step
from hyst_control.records.validity.facts import rails
from hyst_control.records.validity.findings import Finding, Trial
from hyst_control.records.validity.incoherence import LONGEST_RECORD
from hyst_control.records.validity.reference_model import linear_reference
from hyst_control.records.validity.rows import CondensedRows

MODELED = 0.02
"""Share of a measurement's power that a model leaves up to which standing still is the machine's, not the sensor's."""

FROZEN = 0.3  # Share of the command's range that passes while the measurement stands still
LONG_STILL = 0.05  # Share of a record for which a measurement must keep one value to stand still


def is_modeled(trial: Trial, index: int) -> bool:
    """True where a model explains an axis but for a few percent of its power: a compensator's output may stand still."""
    return trial.simulated is not None and unexpected_share(trial.simulated[:, index], trial.measurement[:, index]) < MODELED


def unexpected_share(expected: Array, measured: Array) -> float:
    """Share of a measurement's power (N,) that is not what was expected, but for a constant."""
    return float(np.var(measured - expected)) / max(float(np.var(measured)), 1e-300)


def dead_sensor(trial: Trial, index: int) -> Finding | None:
    """A sensor that keeps one value, or two neighboring ones, or stands still while the command moves."""
    command, values = trial.command[:, index], trial.measurement[:, index]
    few = len(np.unique(values[:LONGEST_RECORD])) <= 2 and len(np.unique(command[:LONGEST_RECORD])) > 2
    still = max(_standing_still(values), key=lambda rows: float(np.ptp(command[rows])), default=slice(0, 1))
    passed = 1.0 if few else float(np.ptp(command[still])) / float(np.ptp(command))
    if passed <= FROZEN or (not few and rails(command, values) is not None):
        return None
    if few:
        detail, remedy = "(all its samples have one value, or two)", ""
    else:
        begin, count = still.start, int(np.flatnonzero(np.diff(values[still.start :], append=np.nan))[0]) + 1
        detail = (
            f"(on {values[begin]:.4g} {trial.unit} for {count} samples from {begin * trial.sample_time:.4g} s on, in which the "
        )
        detail += f"command passes {100 * passed:.0f} % of its range)"
        remedy = "check the sensor and its cable, or keep the rows before or after (hyst edit --from, --to)"
    return Finding("dead_sensor", trial.name, trial.axes[index], passed, FROZEN, detail, remedy)


def _standing_still(values: Array) -> list[slice]:
    """Rows of the long stretches in which a measurement (N,) keeps one value, but for their ends, where a step is only about to follow."""
    edges = np.concatenate([[0], np.flatnonzero(np.diff(values) != 0) + 1, [len(values)]])
    lengths = np.diff(edges)
    long = np.flatnonzero(lengths >= max(LONG_STILL * len(values), 3))
    return [slice(edges[run], max(edges[run + 1] - lengths[run] // 10, edges[run] + 2)) for run in long]


def moves_less_than_a_step(trial: Trial, left: CondensedRows, index: int) -> bool:
    """True where a linear model expects a coarse sensor to stand still wherever it does: a fast command may move a plant that little."""
    step = quantization_step(trial.measurement[:LONGEST_RECORD, index])
    measured = left.measurement[:, index]
    still = _standing_still(measured)
    if not step or not still:
        return False
    apart = np.abs(linear_reference(left.inputs(index), measured).predicted - measured)
    return all(float(apart[rows].max()) < step for rows in still)
