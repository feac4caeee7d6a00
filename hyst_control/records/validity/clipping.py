# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A level of the command beyond which it has no effect."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.records.validity.findings import Finding, Trial
from hyst_control.records.validity.reference_model import Reference, continued, surely_better
from hyst_control.records.validity.rows import CLEAR_LEAD, SATURATION_MATTERS

CLIPPED_SHARES = (0.5, 0.6, 0.7, 0.75, 0.8, 0.85, 0.9, 0.95)  # Shares of the command's range at which that is tried

OUTER, MIN_OUTER, SPREAD, FLAT = 0.9, 20, 0.015, 0.35
"""Share of the range beyond which the measurement's slope is looked at, rows there and how far they spread, and the share of the whole
slope that is flat."""


def clipping_findings(trial: Trial, index: int, command: Array, measured: Array, ahead: Reference) -> Iterator[Finding]:
    """A level of the command beyond which it has no effect."""
    own = index if command.shape[1] > 1 else 0
    values = command[:, own]
    lower, span = float(values.min()), float(np.ptp(values))
    if ahead.unexplained < SATURATION_MATTERS:
        return
    slope = _slope(values, measured)
    tried = {}
    for upper in (True, False):
        outer = values > lower + OUTER * span if upper else values < lower + (1.0 - OUTER) * span
        if (
            outer.sum() < MIN_OUTER
            or np.std(values[outer]) < SPREAD * span
            or abs(_slope(values[outer], measured[outer])) > FLAT * abs(slope)
        ):
            continue
        for share in CLIPPED_SHARES:
            level = lower + (share if upper else 1.0 - share) * span
            changed = command.copy()
            changed[:, own] = np.minimum(values, level) if upper else np.maximum(values, level)
            tried[level] = continued(changed, measured, ahead)
    if not tried:
        return
    level = min(tried, key=lambda each: tried[each].unexplained)
    if surely_better(tried[level], ahead, CLEAR_LEAD):
        side = "above" if level > lower + 0.5 * span else "below"
        yield Finding("clipped_command", trial.name, trial.axes[index], level, 0.0, f"{side} about {level:.3g} V")


def _slope(command: Array, measured: Array) -> float:
    about = command - command.mean()
    return float(about @ measured) / max(float(about @ about), 1e-300)
