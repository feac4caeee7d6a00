# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Drift of records for families whose search does not estimate it: it is removed from the records before the fit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.records.record import Record

LAGS, ROWS = 64, 50_000
"""Taps of the response that stands for the plant, and rows at most to which it is fitted."""
WORTHWHILE = 0.03
"""Share of what that response leaves of a record that the drift must explain to be removed."""
DISTINCT = 0.2
"""Share of a ramp that the command must not explain for a drift to be told from the plant's answer."""


def without_drift(records: Sequence[Record]) -> list[Record]:
    """Remove the drift of every record in which it shows.

    A slow ramp has power at every low frequency, where a linear model takes it for poles of the plant.
    """
    cleaned = []
    for data in records:
        slope = drift(data.command, data.measurement)
        ramp = np.linspace(-1.0, 1.0, len(data.command))[:, None] * slope
        cleaned.append(data.with_values(measurement=data.measurement - ramp) if np.any(slope) else data)
    return cleaned


def drift(command: Annotated[Array, "N A"], measurement: Annotated[Array, "N A"]) -> Annotated[Array, "A"]:
    """Drift of a record, beside what follows the command."""
    lags = min(LAGS, max(len(command) // 8, 1))
    rows = np.unique(np.linspace(lags, len(command) - 1, min(ROWS, len(command) - lags)).astype(int))
    taps = [command[rows - lag] for lag in range(lags)]
    time = (2.0 * rows / (len(command) - 1) - 1.0)[:, None]
    plain = np.hstack([*taps, np.ones((len(rows), 1))])
    # The ramp, and the measurement, without what the command and a constant explain of them.
    left = np.hstack([time, measurement[rows]])
    left = left - plain @ np.linalg.lstsq(plain, left, rcond=1e-9)[0]
    ramp, rest = left[:, 0], left[:, 1:]
    energy = float(ramp @ ramp)
    if energy < DISTINCT * float(np.sum((time - time.mean()) ** 2)):
        return np.zeros(measurement.shape[1])
    slope = ramp @ rest / energy
    explained = slope**2 * energy
    found: Array = np.where(explained > WORTHWHILE * np.sum(rest**2, axis=0), slope, 0.0)
    return found
