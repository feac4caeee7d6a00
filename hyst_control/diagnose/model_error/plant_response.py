# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Filter behind a model for what its linear dynamics lack beside the plant's, from a baseline record of the same command.

A model's error that is carried over sample by sample holds for the plant as it was. An effect before the mechanics moves the model's
output, and the plant answers that with its own dynamics. The filter 1 + Σ c_j q^-j that turns the model's output into what the plant did,
as far as any filter does, answers it as the plant would:

    minimize |error - Σ c_j q^-j output|² + RIDGE |output|² Σ c_j²
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from scipy.linalg import solve_toeplitz

from hyst_control.base.arrays import Array
from hyst_control.base.signals import correlated
from hyst_control.records.session_zero import without_zero

TAPS = 512  # Rows that the filter reaches back
ROWS_PER_TAP = 8  # Rows of the records for each tap
RIDGE = (
    1e-4  # Least power of the model's output at a frequency, as a share of the largest, from which the filter is determined there
)


def lacking_response(
    outputs: Sequence[Annotated[Array, "N A"]], errors: Sequence[Annotated[Array, "N A"]]
) -> Annotated[Array, "K A"]:
    """Coefficients c_j of each axis from the model's outputs on baseline records and its errors there."""
    axes = outputs[0].shape[1]
    count = min(TAPS, sum(map(len, outputs)) // ROWS_PER_TAP)
    found = np.zeros((max(count, 1), axes))
    for axis in range(axes):
        power, cross = np.zeros((2, len(found)))
        for output, error in zip(outputs, errors, strict=True):
            moved, left = (without_zero(rows[:, axis : axis + 1])[0][:, 0] for rows in (output, error))
            reach = min(len(found), len(moved))
            middle = len(moved) - 1
            power[:reach] += correlated(moved, moved)[middle : middle + reach]
            cross[:reach] += correlated(left, moved)[middle : middle + reach]
        if power[0] > 0.0:
            found[:, axis] = solve_toeplitz(power + RIDGE * power[0] * (np.arange(len(power)) == 0), cross)
    return found
