# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Latency of the loop as the actuator's side sees it: from a measurement that was sent to the command that follows from it."""

from __future__ import annotations

import time

from hyst_control.nodes.signal_node.duration_histogram import Durations

AWAITED = 64  # Most measurements whose command is awaited


class LoopLatency:
    """Durations between measurements and their commands."""

    def __init__(self) -> None:
        self._sent: dict[int, int] = {}  # time of sending of the newest measurements, ns since the epoch, by tick
        self._durations = Durations()

    def sent(self, tick: int) -> None:
        """Note that the measurement of a `tick` is being sent."""
        self._sent[tick] = time.time_ns()
        if len(self._sent) > AWAITED:
            del self._sent[next(iter(self._sent))]

    def answered(self, tick: int, stamp: int) -> None:
        """Count the command of a `tick`, which was received at `stamp`, ns since the epoch."""
        sent = self._sent.pop(tick, None)
        if sent is not None:
            self._durations.add(1e-9 * (stamp - sent))

    def entries(self) -> dict[str, str]:
        """Entries of the diagnostics."""
        return self._durations.entries("loop latency")
