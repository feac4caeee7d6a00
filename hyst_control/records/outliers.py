# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Single samples that jump away from both neighbors and from the running median, without a jump of the command next to them."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array, Mask

THRESHOLD, WINDOW = 8.0, 7
"""Size of the jump, in standard deviations of the signal's roughness there and in the whole record; samples of the running median."""
NEARBY = 21  # Samples around one whose roughness, and whose jumps of the command, count as those of its neighborhood
JUMP = 0.01  # Share of its range by which a command jumps within one sample
ROUNDED = 3.0  # Least size in steps of a sensor's rounding, between two of which noise flips
NORMAL_75, NORMAL_95 = 1.15, 1.96  # Quantiles of the size of normal noise in its standard deviation


def outlying(
    values: Annotated[Array, "N A"], command: Annotated[Array, "N C"], threshold: float = THRESHOLD, window: int = WINDOW
) -> Annotated[Mask, "N A"]:
    """Samples of signals that are outliers. Steps, turning points and responses to a jump of the command are none."""
    # The median follows the former, and the latter are no steeper than the motion around them.
    jump = np.zeros_like(values)
    jump[1:-1] = np.abs(values[1:-1] - 0.5 * (values[:-2] + values[2:]))
    usual = np.quantile(jump, 0.95, axis=0) / NORMAL_95
    if not np.any(jump > threshold * usual):
        return np.zeros(values.shape, bool)
    from scipy.ndimage import maximum_filter, median_filter, percentile_filter

    distance = np.abs(values - median_filter(values, size=(window, 1), mode="nearest"))
    deviation = np.maximum(percentile_filter(jump, 75, size=(NEARBY, 1), mode="nearest") / NORMAL_75, usual)
    steps = np.abs(np.diff(values, axis=0, append=values[-1:]))
    steepness = percentile_filter(steps, 75, size=(NEARBY, 1), mode="nearest")
    rounding = ROUNDED * np.min(steps, axis=0, where=steps > 0.0, initial=np.inf)
    least = np.maximum(threshold * deviation, np.maximum(2.0 * steepness, np.where(np.isfinite(rounding), rounding, 0.0)))
    least += 1e-12 * np.ptp(values, axis=0)
    # A machine answers a jump of its command by one as short.
    steps = np.abs(np.diff(command, axis=0, prepend=command[:1]))
    usual = np.maximum(threshold * percentile_filter(steps, 75, size=(NEARBY, 1), mode="nearest"), JUMP * np.ptp(command, axis=0))
    near = maximum_filter(np.any(steps > usual, axis=1, keepdims=True), size=(NEARBY, 1))
    return np.asarray((np.minimum(distance, jump) > least) & (jump == maximum_filter(jump, size=(3, 1))) & ~near)
