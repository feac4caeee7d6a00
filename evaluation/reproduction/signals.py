# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Figures of driven signals that both papers have: response at one frequency, area of a loop, deviation of a response from 1."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array, Complex
from hyst_control.reporting.tables import Table


def fundamental(output: Annotated[Array, "N"], driven: Annotated[Array, "N"], frequency: float, sample_time: float) -> complex:
    """Response at one frequency (Hz), over whole cycles."""
    turn = np.exp(-2j * np.pi * frequency * sample_time * np.arange(len(output)))
    return complex((turn @ output) / (turn @ driven))


def lag(output: Annotated[Array, "N"], driven: Annotated[Array, "N"], frequency: float, sample_time: float) -> float:
    """Lag at one frequency, degrees."""
    return float(-np.degrees(np.angle(fundamental(output, driven, frequency, sample_time))))


def loop_area(u: Annotated[Array, "N"], y: Annotated[Array, "N"], cycles: int = 1) -> float:
    """Area of a loop, the mean of whole cycles, over that of its box, %."""
    area = 0.5 * abs(float(np.sum(u * np.roll(y, -1) - y * np.roll(u, -1)))) / cycles
    return float(100.0 * area / np.ptp(u) / np.ptp(y))


def add_deviation(table: Table, title: str, case: str, subject: str, value: Complex) -> None:
    """Add the largest deviations of a response's gain and phase from 1."""
    table.add(title, case, subject, "largest gain error", "dB", np.abs(20 * np.log10(np.abs(value))).max())
    table.add(title, case, subject, "largest phase error", "deg", np.abs(np.degrees(np.angle(value))).max())
