# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Learning on the simulated mirror through the real nodes: from trial to trial, and of gain and lag from the feedback. Past the papers."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from evaluation.reproduction.margins import MEASURED
from evaluation.reproduction.mhl_runs import CENTRE, REACH, SAMPLE_TIME, track
from evaluation.reproduction.mhl_tables import TRADITIONAL
from hyst_control.base.arrays import Array
from hyst_control.control.tuning import Tuning
from hyst_control.records.excitation import excitation
from hyst_control.reporting.tables import Table

TRIALS = "MHL learning from trial to trial"
FEEDBACK_ERROR = "MHL learning from the feedback"
FREQUENCY = 100.0
"""Hz, of the reference that repeats, on both axes."""
PERIODS = 3
"""Periods of a trial: one that settles, two that are measured and scored."""
TRIAL_COUNT = 6
GAIN_ERROR = 0.1
CHANGES: dict[str, dict[str, Any]] = {
    "mirror as identified": {},
    f"gain {GAIN_ERROR:+.0%}": {"effects": f"[{{name: gain, gain: {GAIN_ERROR}}}]"},
    "first mode -20%": {"parameters": f"{{mode_frequency: [{', '.join(f'{0.8 * mode:g}' for mode in MEASURED['fsm'][0])}]}}"},
}
"""Parameters of the plant node by case: the mirror may have changed since it was identified."""
LEARNED_TIME = 2.0
"""s, of the run that learns from the feedback; its first and its last tenth are scored."""


def add(table: Table, folder: Path, tuning: Tuning, preview: int, smoothing: int) -> None:
    """Run and add what is learned."""
    period = round(1.0 / FREQUENCY / SAMPLE_TIME)
    trials = {"learning": "trials", "learning_period": period, "learning_settling": 1, "learning_averaged": PERIODS - 1}
    static = {"inverse_model": str(folder / "inverse.yaml"), "discretisation": "tustin"}
    for index, (case, change) in enumerate(CHANGES.items()):
        where, count = folder / f"trials_{index}", TRIAL_COUNT * PERIODS
        errors = repeated(where, "mhl_static", {**static, **trials}, count, tuning, 0, change)
        for number, error in enumerate(errors.reshape(TRIAL_COUNT, PERIODS, -1)[:, 1:]):
            table.add(TRIALS, f"{case}, trial {number}", TRADITIONAL, "nrmse", "%", nrmse(error))
    whole = {"smoothing": smoothing}
    periods = round(LEARNED_TIME * FREQUENCY)
    tenth = periods // 10
    for index, (case, change) in enumerate(list(CHANGES.items())[:2]):
        for subject, learning, count in (
            ("whole inverse", {}, tenth),
            ("whole inverse, learning", {"learning": "feedback_error"}, periods),
        ):
            where = folder / f"feedback_{index}_{len(learning)}"
            errors = repeated(where, "mhl_inverse", {**whole, **learning}, count, tuning, preview, change)
            for name, part in (("first tenth", errors[1:tenth]), ("last tenth", errors[-tenth:])):
                if learning or name == "first tenth":
                    table.add(FEEDBACK_ERROR, f"{case}, {name}", subject, "nrmse", "%", nrmse(part))


def repeated(
    folder: Path, kind: str, settings: Mapping[str, Any], periods: int, tuning: Tuning, preview: int, change: Mapping[str, Any]
) -> Array:
    """Track a sine that repeats, on both axes."""
    wave = excitation.sine(SAMPLE_TIME, FREQUENCY, REACH, CENTRE, 1.0 / FREQUENCY, -np.pi / 2)
    reference = np.tile(np.stack([wave, wave], axis=1), (periods, 1))
    signals = track(folder, kind, reference, tuning, settings, preview, change)
    return np.asarray(signals["reference"] - signals["measurement"]).reshape(periods, -1)


def nrmse(error: Array) -> float:
    """Rms of an `error` in mrad, in % of the reference's range."""
    return 100.0 * float(np.sqrt(np.mean(error**2))) / (2.0 * REACH)
