# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Clocks of the sources a node hears, held against its own: rows that are ticks of another clock are found while they come."""

from __future__ import annotations

import math

CLOCK_REMEDY = "a tick is floor(CLOCK_MONOTONIC / period) on one machine (docs/hardware.md)"


class SourceClocks:
    """Differences between the times of received rows and the clock, each the smallest since the last look."""

    def __init__(self) -> None:
        self.now, self.latest = 0.0, math.inf
        self._least: dict[str, float] = {}
        self._told: dict[str, float] = {}

    def look_at(self, now: float, most_ahead: float) -> None:
        """Set the time for the messages that are taken next."""
        self.now, self.latest = now, now + most_ahead

    def heard(self, topic: str, newest: float) -> None:
        """Count a message."""
        ahead = newest - self.now
        known = self._least.get(topic)
        if known is None or abs(ahead) < abs(known):
            self._least[topic] = ahead

    def look(self, behind: float, ahead: float) -> dict[str, float]:
        """Sources whose rows were all older than `behind` or further ahead than `ahead`, both in s, since the last look."""
        self._told, self._least = self._least, {}
        return {topic: found for topic, found in self._told.items() if not -behind <= found <= ahead}

    def entries(self) -> dict[str, str]:
        """Entries of the diagnostics, as of the last look."""
        return {f"clock of {topic} [s]": f"{found:.4f}" for topic, found in self._told.items()}


def describe(ahead: float) -> str:
    """Difference in words, such as "3 s behind", of a time that is so much `ahead`, s."""
    return f"{abs(ahead):.4g} s {'ahead of' if ahead > 0 else 'behind'}"
