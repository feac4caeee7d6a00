# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Excess of a residual over the model discrepancy, octave by octave.

The spectrum of the own error is an upper envelope, and the error is one shape, not noise: what is left under it is no evidence, however
many samples it has. Beyond it an octave counts as much as it exceeds it, and slower the further it does, for the envelope of an octave is
known to a factor only (Student's t with an unknown scale).
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from scipy.fft import dct

from hyst_control.base.arrays import Array
from hyst_control.diagnose.problem.problem import Problem

FREEDOM = 3.0
"""Degrees of freedom of the scale of an octave's own error."""
FIRST = 4
"""Bins of the slowest band."""


def beyond_own_error(problem: Problem, residual: Annotated[Array, "M"]) -> float:
    """Weigh what a residual has beyond the model discrepancy and the noise."""
    found = 0.0
    for rows in problem.by_piece(residual):
        octave = np.maximum(np.floor(np.log2(np.arange(len(rows)) / FIRST + 1e-9)).astype(int) + 1, 0)
        bins = np.bincount(octave).astype(float)
        for column in dct(rows, norm="ortho", axis=0).T:
            energy = np.maximum(np.bincount(octave, column**2), bins)
            found += float(np.sum(0.5 * (FREEDOM + bins) * np.log((FREEDOM + energy) / (FREEDOM + bins))))
    return found
