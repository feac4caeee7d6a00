"""Clocks of the sources a node hears, held against its own: rows that are ticks of another clock are told while they come."""

from __future__ import annotations

import math

CLOCK_REMEDY = "a tick is floor(CLOCK_MONOTONIC / period) on one machine (docs/hardware.md)"


class SourceClocks:
    """Differences between the times of received rows and the clock, each the smallest since the last look.

    Attributes
    ----------
    now : float
        Time of the clock when the messages are taken, s: once for all of a tick.
    latest : float
        Time that no row may be beyond, s.
    """

    def __init__(self) -> None:
        self.now, self.latest = 0.0, math.inf
        self._least: dict[str, float] = {}
        self._told: dict[str, float] = {}

    def look_at(self, now: float, most_ahead: float) -> None:
        """Set the time for the messages that are taken next.

        Parameters
        ----------
        now : float
            Time of the clock, s.
        most_ahead : float
            Time that rows may be ahead of it, s.
        """
        self.now, self.latest = now, now + most_ahead

    def heard(self, topic: str, newest: float) -> None:
        """Count a message.

        Parameters
        ----------
        topic : str
            Its topic.
        newest : float
            Time of its newest row, s: on one clock some milliseconds before `now`, or behind it by a lead.
        """
        ahead = newest - self.now
        known = self._least.get(topic)
        if known is None or abs(ahead) < abs(known):
            self._least[topic] = ahead

    def look(self, behind: float, ahead: float) -> dict[str, float]:
        """Sources whose rows were all older than `behind` or further ahead than `ahead`, both in s, since the last look.

        Returns
        -------
        dict of str to float
            Difference in s by topic; negative for rows that are old.
        """
        self._told, self._least = self._least, {}
        return {topic: found for topic, found in self._told.items() if not -behind <= found <= ahead}

    def entries(self) -> dict[str, str]:
        """Entries of the diagnostics, as of the last look."""
        return {f"clock of {topic} [s]": f"{found:.4f}" for topic, found in self._told.items()}


def describe(ahead: float) -> str:
    """Difference in words, such as "3 s behind", of a time that is so much `ahead`, s."""
    return f"{abs(ahead):.4g} s {'ahead of' if ahead > 0 else 'behind'}"
