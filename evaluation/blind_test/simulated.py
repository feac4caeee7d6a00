# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Simulated cases: record, model and label of each, with its true gap and visibility, and the reduction on a later session."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np

from evaluation.blind_test.case import Case, Label, Made
from evaluation.blind_test.case_records import commands, plant_of, record_of, respond, run_case
from evaluation.blind_test.nominal_models import nominal, stated_noise
from evaluation.blind_test.plant_setups import SETUPS
from hyst_control.base.arrays import Array
from hyst_control.diagnose.report.augmented_model import without_lines
from hyst_control.model_file import Model, simulate

MIN_VISIBILITY = 10.0
"""Distance (standard deviations, coefficients marginalized) below which a gap is invisible: such a case counts as none."""


def made(case: Case) -> Made:
    """Make a case: its model and record, and the command of a later session under another excitation."""
    record, coming = record_of(case, run_case(case)), commands(_later(case))
    return Made(record, nominal(case.plant, case.noise), label_of(case), case.effects, coming=coming)


def label_of(case: Case) -> Label:
    """Find the label of a case; a pair's also lists the effects that are `shown`: visible beside the other."""
    setup = SETUPS[case.plant]
    noise = case.noise * setup.stroke
    stated = stated_noise(case.plant, case.noise)
    gap, distance = 0.0, 0.0
    least = 0.2 * noise if setup.model is not None else 1.5 * stated  # a gap below the model discrepancy cannot be detected
    within = case.kind != "parameters"  # coefficients outside their tolerance are themselves the gap
    wrong = bool(case.effects) or not within
    if wrong:
        difference = _difference(case, replace(case, effects=()), within)
        gap = float(np.sqrt(np.mean(difference**2)))
        distance = visibility(case, difference, stated)
    label = Label(case.kind, case.names, gap, noise, distance)
    if wrong and (distance < MIN_VISIBILITY or gap < least):
        return replace(label, kind="none", names=(), hidden=case.names or (case.kind,))
    if case.kind != "pair":
        return label
    shown = []
    for effect in case.effects:
        part = _difference(case, replace(case, effects=tuple(other for other in case.effects if other is not effect)))
        size = visibility(replace(case, effects=(effect,)), part, stated)
        if size >= MIN_VISIBILITY and float(np.sqrt(np.mean(part**2))) >= least:
            shown.append(effect["name"])
    return replace(label, shown=tuple(shown))


def _difference(case: Case, other: Case, scattered: bool = True) -> Array:
    """Difference (N, A) of the noiseless measurements of two cases' plants; `scattered`: the other's coefficients scatter."""
    if case.excitation == "closed_loop":  # a loop hides a gap: both plants are driven by the same command
        command = run_case(case, noisy=False)["command"]
        truth, bare = plant_of(case, noisy=False), plant_of(other, noisy=False, scattered=scattered)
        measured, expected = respond(truth, command), respond(bare, command)
    else:
        measured = run_case(case, noisy=False)["measurement"]
        expected = run_case(other, noisy=False, scattered=scattered)["measurement"]
    return np.asarray(measured - expected, dtype=np.float64)


def visibility(case: Case, difference: Annotated[Array, "N A"], noise: float) -> float:
    """Distance of a difference from any change of gain and offset on each axis."""
    measured = run_case(case, effects=False, noisy=False)["measurement"]
    left = 0.0
    for axis in range(difference.shape[1]):
        known = np.stack([np.ones(len(measured)), measured[:, axis]], axis=1)
        if case.names and set(case.names) <= {"gain", "offset"}:
            known = known[:, :0]
        rest = difference[:, axis] - (known @ np.linalg.lstsq(known, difference[:, axis], rcond=None)[0] if known.shape[1] else 0.0)
        left += float(rest @ rest)
    return float(np.sqrt(left) / noise)


def realized_reduction(case: Case, model: Model, better: Model) -> float:
    """Share of the gap's energy that the augmented model takes off in a later session, under another excitation.

    A line is left out of the augmented model, because its phase is that of the diagnosed record.
    """
    signals = run_case(_later(case), later=True)
    command, measured = signals["command"], signals["measurement"]
    before, after = (float(np.mean((measured - simulate(m, command)) ** 2)) for m in (model, without_lines(better)))
    floor = (case.noise * SETUPS[case.plant].stroke) ** 2
    return float(np.clip(1.0 - (after - floor) / max(before - floor, 1e-300), -10.0, 1.0))


def _later(case: Case) -> Case:
    """The same plant under another excitation, on which predictions are checked."""
    return replace(case, excitation="multisine" if case.excitation == "rich" else "rich")
