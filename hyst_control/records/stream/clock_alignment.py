# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Records whose topics have sample times of different clocks, put on one by the time at which their messages were received."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hyst_control.records.record import Record


def aligned_by_reception(record: Record, topics: Sequence[str]) -> Record:
    """Put topics whose sources count from their own start on the clock of the first one, by whole samples, as received."""
    signals = [record.signals[topic] for topic in topics if topic in record.signals and len(record.signals[topic].time) > 1]
    if len(signals) < len(topics) or any(math.isnan(signal.received) for signal in signals):
        return record
    if max(signal.time[0] for signal in signals) <= min(signal.time[-1] for signal in signals):
        return record
    step = record.common_step(topics)
    moved, told = dict(record.signals), []
    for topic, signal in zip(topics[1:], signals[1:], strict=True):
        ticks = round((signal.received - signals[0].received) / step)
        if ticks:
            moved[topic] = replace(signal, time=(np.rint(signal.time / step) + ticks) * step)
            told.append(f"{topic} by {ticks * step:.6g} s")
    if not told:
        return record
    note = (
        f"{record.source}: {', '.join(topics)} have the times of different clocks: aligned by the time of reception, {', '.join(told)}; "
        "its jitter is an error of the delay"
    )
    return replace(record, signals=moved, notes=(*record.notes, note))
