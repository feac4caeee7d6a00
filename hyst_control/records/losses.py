# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Account of a bag by topic: rows that were sent, received and missed, values that are no numbers, and the clock of its times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hyst_control.records.actuator_following import APPLIED
from hyst_control.records.record import Record, Signal, commonest_step
from hyst_control.records.stream.foreign_rows import admissible
from hyst_control.records.stream.row_store import blocks

CLOCKS = {"layout": "control clock", "receive": "time of reception"}  # Clocks by the timing of a signal
BETWEEN = 1.5  # Steps between two times of reception from which on a row is missing between them


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


def losses(records: Sequence[Record]) -> tuple[list[dict[str, Any]], list[str]]:
    """Rows sent, received and missed by record and topic, for a report, and a sentence on each topic that misses any."""
    rows, notes = [], []
    for record in records:
        for topic, signal in sorted(record.signals.items()):
            received = len(signal.time)
            _, missing, longest, _ = _gaps(topic, signal)
            sent = received + missing
            rows.append({"record": record.source, "topic": topic, "sent": sent, "received": received, "missed": missing})
            if missing:
                notes.append(f"{record.source}: {topic}: {missing} of {sent} rows are missing, at most {longest} in a row")
    return rows, notes


def account(record: Record) -> list[TopicAccount]:
    """Account of every topic of a record, in the order of their names."""
    found = []
    for topic, signal in sorted(record.signals.items()):
        time = signal.time
        invalid = sum(int(np.count_nonzero(~admissible(signal.values[part]))) for part in blocks(len(time)))
        first, last = (float(time[0]), float(time[-1])) if len(time) else (np.nan, np.nan)
        step, missing, longest, irregular = _gaps(topic, signal)
        clock = CLOCKS[signal.timing]
        found.append(TopicAccount(topic, clock, len(time), step, first, last, missing, longest, irregular, invalid))
    return found


def _gaps(topic: str, signal: Signal) -> tuple[float, int, int, float]:
    """Step, missing, longest and irregular of a topic's account, block by block, as a record may be longer than the memory."""
    time = signal.time
    if len(time) < 2:
        return np.nan, 0, 0, 0.0
    step = commonest_step(time)
    if topic == APPLIED or not step > 0.0:  # published only while the actuator does not follow the command
        return step, 0, 0, 0.0
    missing = longest = 0
    irregular = 0.0
    for part in blocks(len(time) - 1):
        steps = np.diff(time[part.start : part.stop + 1]) / step
        gaps = np.maximum(np.rint(steps) - 1.0, 0.0)
        if signal.timing != "layout":
            gaps[steps <= BETWEEN] = 0.0
        missing, longest = missing + int(gaps.sum()), max(longest, int(gaps.max()))
        irregular = max(irregular, float(np.abs(steps - 1.0 - gaps).max()))
    return step, missing, longest, irregular
