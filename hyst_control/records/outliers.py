# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Single samples that jump away from both neighbors and from the running median, by far more than an answer to the command does."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array, Mask

THRESHOLD, WINDOW = 8.0, 7
"""Size of the jump, in standard deviations of the signal's roughness there and in the whole record; samples of the running median."""
NEARBY = 21  # Samples around one whose roughness, and whose jumps of the command, count as those of its neighborhood
JUMP = 0.01  # Share of its range by which a command jumps within one sample
ANSWER, ANSWERS = 3.0, 0.9
"""Ratio of an outlier next to a jump of the command and what most such jumps lead to, each for its size; and how many are most."""
ROUNDED = 3.0  # Least size in steps of a sensor's rounding, between two of which noise flips
NORMAL_60, NORMAL_95 = 0.842, 1.96  # Quantiles of the size of normal noise in its standard deviation


def outlying(
    values: Annotated[Array, "N A"], command: Annotated[Array, "N C"], threshold: float = THRESHOLD, window: int = WINDOW
) -> Annotated[Mask, "N A"]:
    """Samples of signals that are outliers. Steps, turning points and responses to a jump of the command are none."""
    # The median follows the former, and the latter are no steeper than the motion around them, or than the answers to other jumps.
    jump = np.zeros_like(values)
    jump[1:-1] = np.abs(values[1:-1] - 0.5 * (values[:-2] + values[2:]))
    usual = np.quantile(jump, 0.95, axis=0) / NORMAL_95
    if not np.any(jump > threshold * usual):
        return np.zeros(values.shape, bool)
    from scipy.ndimage import maximum_filter, median_filter, percentile_filter

    distance = np.abs(values - median_filter(values, size=(window, 1), mode="nearest"))
    # Two outliers nearby, each of which three jumps are of, do not hide each other.
    deviation = np.maximum(percentile_filter(jump, 60, size=(NEARBY, 1), mode="nearest") / NORMAL_60, usual)
    steps = np.abs(np.diff(values, axis=0, append=values[-1:]))
    steepness = percentile_filter(steps, 75, size=(NEARBY, 1), mode="nearest")
    rounding = ROUNDED * np.min(steps, axis=0, where=steps > 0.0, initial=np.inf)
    least = np.maximum(threshold * deviation, np.maximum(2.0 * steepness, np.where(np.isfinite(rounding), rounding, 0.0)))
    least += 1e-12 * np.ptp(values, axis=0)
    size = np.minimum(distance, jump)
    least = np.maximum(least, _largest_answer(size, command, threshold))
    return np.asarray((size > least) & (jump == maximum_filter(jump, size=(3, 1))))


def _largest_answer(size: Annotated[Array, "N A"], command: Annotated[Array, "N C"], threshold: float) -> Annotated[Array, "N A"]:
    """Largest size of a sample that a jump of the command nearby explains; 0 where there is none."""
    from scipy.ndimage import maximum_filter, percentile_filter

    steps = np.abs(np.diff(command, axis=0, prepend=command[:1]))
    usual = np.maximum(threshold * percentile_filter(steps, 75, size=(NEARBY, 1), mode="nearest"), JUMP * np.ptp(command, axis=0))
    jumps = np.max(np.where(steps > usual, steps / np.maximum(np.ptp(command, axis=0), 1e-300), 0.0), axis=1, keepdims=True)
    if not np.any(jumps):
        return np.zeros_like(size)
    near, rows = maximum_filter(jumps, size=(NEARBY, 1)), np.flatnonzero(jumps)
    # Of few jumps the largest answer is among the most: nothing then tells an outlier beside one of them from its answer.
    answers = maximum_filter(size, size=(NEARBY, 1))[rows] / near[rows]
    return np.asarray(ANSWER * np.quantile(answers, ANSWERS, axis=0) * near)
