# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Account of a bag by topic: rows that are there, ticks that are missing, values that are no numbers, and the clock of its times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.records.actuator_following import APPLIED
from hyst_control.records.record import Record, Signal, commonest_step
from hyst_control.records.stream.foreign_rows import admissible

CLOCKS = {"layout": "control clock", "receive": "time of reception"}
"""Clocks by the timing of a signal."""
BETWEEN = 1.5
"""Steps between two times of reception from which on a row is missing between them."""


@dataclass(frozen=True)
class TopicAccount:
    """Account of a topic from its first to its last row."""

    topic: str
    clock: str
    rows: int
    step: float  # s, the commonest between rows; NaN of less than two
    first: float  # s
    last: float  # s
    missing: int  # Ticks without a row; 0 of a topic that is published only at times
    longest: int  # Of these, the most in a row
    irregular: float  # Largest distance of a step from the commonest, in steps, where none is missing
    invalid: int  # Rows with a value that is not finite or beyond all measure

    @property
    def whole(self) -> bool:
        """True where no row is missing and every value is a number."""
        return bool(self.rows) and not self.missing and not self.invalid


def account(record: Record) -> list[TopicAccount]:
    """Account of every topic of a record, in the order of their names."""
    return [_of_topic(topic, signal) for topic, signal in sorted(record.signals.items())]


def _of_topic(topic: str, signal: Signal) -> TopicAccount:
    time, clock = signal.time, CLOCKS[signal.timing]
    invalid = int(np.count_nonzero(~admissible(signal.values))) if len(time) else 0
    if len(time) < 2:
        ends = (float(time[0]), float(time[0])) if len(time) else (np.nan, np.nan)
        return TopicAccount(topic, clock, len(time), np.nan, *ends, 0, 0, 0.0, invalid)
    step = commonest_step(time)
    steps = np.diff(time) / step if step > 0.0 else np.zeros(len(time) - 1)
    # What is on the actuator is told only while it does not follow the command.
    gaps = np.zeros(len(steps)) if topic == APPLIED else _missing(steps, signal.timing)
    irregular = float(np.abs(steps - 1.0 - gaps).max()) if topic != APPLIED else 0.0
    return TopicAccount(
        topic, clock, len(time), step, float(time[0]), float(time[-1]), int(gaps.sum()), int(gaps.max()), irregular, invalid
    )


def _missing(steps: Array, timing: str) -> Array:
    """Rows missing between each row and the next."""
    if timing == "layout":
        return np.maximum(np.rint(steps) - 1.0, 0.0)
    return np.where(steps > BETWEEN, np.rint(steps) - 1.0, 0.0)
