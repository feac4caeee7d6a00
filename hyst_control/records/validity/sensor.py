# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A sensor that keeps one value, or stands still while the command moves."""

from __future__ import annotations

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.records.validity.facts import rails
from hyst_control.records.validity.findings import Finding, Trial
from hyst_control.records.validity.incoherence import LONGEST_RECORD

MODELED = 0.02
"""Share of a measurement's power that a model leaves up to which standing still is the machine's, not the sensor's."""

FROZEN = 0.3
"""Share of the command's range that passes while the measurement stands still."""

LONG_STILL = 0.05
"""Share of a record for which a measurement must keep one value to stand still."""


def is_modeled(trial: Trial, index: int) -> bool:
    """True where a model explains an axis but for a few percent of its power: a compensator's output may stand still."""
    return trial.simulated is not None and unexpected_share(trial.simulated[:, index], trial.measurement[:, index]) < MODELED


def unexpected_share(expected: Array, measured: Array) -> float:
    """Share of a measurement's power (N,) that is not what was expected, but for a constant."""
    return float(np.var(measured - expected)) / max(float(np.var(measured)), 1e-300)


def dead_sensor(trial: Trial, index: int) -> Finding | None:
    """A sensor that keeps one value, or two neighboring ones, or stands still while the command moves."""
    values = trial.measurement[:, index]
    few = len(np.unique(values[:LONGEST_RECORD])) <= 2 and len(np.unique(trial.command[:LONGEST_RECORD, index])) > 2
    passed = 1.0 if few else _frozen(trial, index)
    if passed <= FROZEN or (not few and rails(trial.command[:, index], values) is not None):
        return None
    return Finding("dead_sensor", trial.name, trial.axes[index], passed, FROZEN)


def _frozen(trial: Trial, index: int) -> float:
    """Largest share of the command's range that passes while the measurement keeps one value for long."""
    command, values = trial.command[:, index], trial.measurement[:, index]
    edges = np.concatenate([[0], np.flatnonzero(np.diff(values) != 0) + 1, [len(values)]])
    lengths = np.diff(edges)
    passed = [0.0]
    for run in np.flatnonzero(lengths >= max(LONG_STILL * len(values), 3)):
        end = edges[run + 1] - lengths[run] // 10  # a step at its end is only about to be followed
        passed.append(float(np.ptp(command[edges[run] : max(end, edges[run] + 2)])))
    return max(passed) / float(np.ptp(command))
