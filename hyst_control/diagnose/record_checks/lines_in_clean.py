# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Lines of the spectrum that baseline records have too: mains hum has another phase in every session, and a difference of two shows it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.diagnose.configuration import CheckSettings
from hyst_control.effects import EFFECTS

DETUNED = (-3.0, 3.0)  # Bins around a frequency at which there is no line if there is one at it


def beyond_clean(
    suggested: Mapping[str, Sequence[float]],
    residual: Annotated[Array, "M A"],
    clean: Sequence[Array],
    sample_time: float,
    settings: CheckSettings,
) -> dict[str, list[float]]:
    """Leave out lines that a baseline record has nearly as large, whatever their phase."""

    def is_new(frequency: float) -> bool:
        new = _amplitude(residual, frequency, sample_time)
        for rows in clean:
            usual = _amplitude(rows, frequency, sample_time)
            around = [_amplitude(rows, frequency + bins / len(rows) / sample_time, sample_time) for bins in DETUNED]
            has_line = usual**2 > settings.mains_ratio * np.mean(np.square(around), axis=0)
            if np.all((new < settings.clean_line * usual) & has_line):
                return False
        return True

    return {name: [value for value in values if EFFECTS[name].line is None or is_new(value)] for name, values in suggested.items()}


def _amplitude(rows: Array, frequency: float, sample_time: float) -> Array:
    """Amplitude (A,) of a sine in rows (N, A), by a Hann window."""
    window = np.hanning(len(rows)) * np.exp(-2j * np.pi * frequency * sample_time * np.arange(len(rows)))
    return np.asarray(2.0 * np.abs(window @ (rows - rows.mean(axis=0))) / np.hanning(len(rows)).sum(), dtype=np.float64)
