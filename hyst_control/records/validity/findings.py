# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Stretches of records for the record checks, and findings with their texts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from hyst_control.base.arrays import Array
from hyst_control.base.yaml_files import read_yaml

Simulation = Callable[[Array, float], Array]
"""Measurements (N, A) that a model makes of commands (N, A) at a sample time in s."""


@dataclass(frozen=True)
class Trial:
    """A gapless stretch of a record."""

    name: str
    command: Array  # (N, A), V
    measurement: Array  # (N, A)
    sample_time: float  # s
    axes: tuple[str, ...]  # Their names
    simulated: Array | None = None  # (N, A), what a model makes of the command
    unit: str = "um"  # Of the measurement
    simulate: Simulation | None = None  # The model, at any command and sample time
    modes: tuple[float, ...] = ()  # Frequencies of its modes, Hz
    delay: float = 0.0  # Its own, s


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong with a record."""

    name: str  # Key of `NAMES`
    record: str  # Its trial's name; two of them joined by " and "
    axis: str  # Its name; "" for all
    value: float  # What was found
    limit: float  # The value that it may have
    detail: str = ""  # The value in words
    remedy: str = ""  # "" for the usual one

    def text(self) -> str:
        """As one line for a person: what, where, remedy."""
        what, remedy = NAMES[self.name]
        where = f"{self.record}: {self.axis}" if self.axis else self.record
        detail = self.detail or f"({self.value:.3g}, limit {self.limit:.3g})"
        return f"{where}: {what} {detail}: {self.remedy or remedy}"

    def document(self) -> dict[str, str | float]:
        """As plain JSON types."""
        return {"name": self.name, "record": self.record, "axis": self.axis, "value": self.value, "limit": self.limit}


def figures(value: float) -> str:
    """Three digits of a value, without an exponent up to a million."""
    return f"{float(f'{value:.3g}'):g}"


def times(ratio: float) -> str:
    """Ratio of two ranges for a person."""
    return f"({figures(max(ratio, 1.0 / ratio))} times as {'large' if ratio > 1.0 else 'small'})"


NAMES: dict[str, list[str]] = read_yaml(Path(__file__).with_name("findings.yaml"))
"""Text of each finding, and the remedy."""

NOTES = (
    *("late_measurement", "clock_difference", "lost_rows", "at_range_end", "clipped_command", "copied_command", "held_command"),
    *("implausible_range", "single_outliers", "stuck_measurement", "slow_sampling"),
)
"""Findings with which a record is used all the same."""
