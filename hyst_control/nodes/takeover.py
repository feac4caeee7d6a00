"""Start of a node that commands an actuator: with the command that is on it, if anybody knows it.

A feedback that was started again does not know where the actuator is. What drives the actuator does: as long as no command arrives, it
publishes on `applied` what it applies (docs/safety.md).
"""

from __future__ import annotations

import math
import time

import numpy as np
from numpy.typing import NDArray

from hyst_control.nodes.base import SignalNode
from hyst_control.records.actuator_following import APPLIED
from hyst_control.records.foreign_rows import Refusal, admit
from hyst_control.records.signal_message import label_for

Array = NDArray[np.float64]

FRESH = 1.0
"""s, for which what was heard counts."""
DISCOVERY = 0.3
"""s, within which programs on one machine usually know of each other."""


class Takeover:
    """Listener of a starting node for the state of the actuator.

    Parameters
    ----------
    node : SignalNode
        The node.
    """

    def __init__(self, node: SignalNode) -> None:
        self._node = node
        self._label = label_for(node.axes, "V")
        self._intake = node.intake(APPLIED)
        self.forget()

    def forget(self) -> None:
        """Begin to wait anew."""
        self.tick, self.command = -1, None
        self._heard = -math.inf
        self._since: float | None = None

    tick: int
    """Tick at which `command` was applied last, -1 when nothing was heard."""
    command: Array | None
    """Value (A,) on the actuator in V; None when nothing was heard."""

    def ready(self, patience: float) -> bool:
        """True when the node may begin: it has heard what is applied, or has listened for `patience` s since the first call.

        While nobody is known who would publish it, it listens for `DISCOVERY` s at most.
        """
        now = time.monotonic()
        if self._since is None:
            self._since = now
        for label, block, _ in self._intake.take(lambda reason: self._node.drop(APPLIED, "unreadable", reason)):
            tick = admit(block, self._node.period) if len(block) and label == self._label else None
            if isinstance(tick, int):
                self.tick, self.command, self._heard = tick + len(block) - 1, block[-1, 1:].copy(), now
            elif isinstance(tick, Refusal):
                self._node.drop(APPLIED, tick.kind, tick.reason)
        if self.command is not None and now - self._heard > FRESH:
            self.tick, self.command = -1, None
        if self.command is not None:
            return True
        listened = now - self._since
        return listened >= patience or listened >= DISCOVERY and not self._node.count_publishers(APPLIED)
