# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""State of the actuator, for the node that commands it: where it begins, and where it waits while the actuator does not follow.

A feedback that was started again does not know where the actuator is. What drives the actuator does: as long as it does not follow the
command, because none arrives or because it was stopped, it publishes on `applied` what it applies (docs/safety.md).
"""

from __future__ import annotations

import math
import time
from functools import partial

import numpy as np

from hyst_control.base.arrays import Array, Mask
from hyst_control.nodes.signal_node.base import SignalNode
from hyst_control.records.actuator_following import APPLIED
from hyst_control.records.stream.foreign_rows import Refusal, admit
from hyst_control.records.stream.row_repetition import SentRows
from hyst_control.records.stream.signal_message import label_for

FRESH = 1.0  # s, for which what was heard counts
DISCOVERY = 0.3  # s, within which programs on one machine usually know of each other
LATE = 0.02  # s, at most, by which an actuator that follows is behind the command


class Takeover:
    """Listener for the state of the actuator."""

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
        self._apart: Array | None = None

    tick: int  # Tick at which `command` was applied last, -1 when nothing was heard
    command: Array | None  # Value (A,) on the actuator in V; None when nothing was heard

    def ready(self, patience: float) -> bool:
        """True when the applied command has arrived, or none in `patience` s; `DISCOVERY` s are enough where nobody publishes it."""
        now = time.monotonic()
        if self._since is None:
            self._since = now
        self._listen(now)
        if self.command is not None and now - self._heard > FRESH:
            self.tick, self.command = -1, None
        if self.command is not None:
            return True
        listened = now - self._since
        return listened >= patience or listened >= DISCOVERY and not self._node.count_publishers(APPLIED)

    def apart(self, sent: SentRows, close: float) -> Array | None:
        """Voltage (A,) of the axes whose actuator does not follow the rows of command that were `sent`, NaN of the others.

        It begins with a voltage that is not within `close` V of the command, and lasts until none was heard for the node's `timeout`.
        None while all axes follow.
        """
        now = time.monotonic()
        if self._listen(now) and self.command is not None:
            away = self._differs(self.command, sent, close)
            if self._apart is not None:
                away |= np.isfinite(self._apart)
            self._apart = np.where(away, self.command, np.nan) if away.any() else None
        elif now - self._heard > self._node.timer.longest_age:
            self._apart = None
        return self._apart

    def _differs(self, applied: Array, sent: SentRows, close: float) -> Mask:
        """Mask (A,) of the axes whose voltage at `self.tick` is none of the commands that may be on the actuator then."""
        rows = sent.since(self.tick - math.ceil(LATE / self._node.period))
        # Up to that tick; where the plant's tick comes before this node's, its command is still to be sent.
        known = min(len(rows) - (sent.end - 1 - self.tick), len(rows)) if rows is not None else 0
        if rows is None or known <= 0:
            return np.zeros(len(applied), bool)
        commanded = rows[:known, 1:]
        return np.asarray(np.abs(np.clip(applied, commanded.min(axis=0), commanded.max(axis=0)) - applied) > close)

    def _listen(self, now: float) -> bool:
        """True when something was heard."""
        heard = False
        for label, block, _ in self._intake.take(partial(self._node.drop, APPLIED, "unreadable")):
            tick = admit(block, self._node.period) if len(block) and label == self._label else None
            if isinstance(tick, int):
                self.tick, self.command, self._heard, heard = tick + len(block) - 1, block[-1, 1:].copy(), now, True
            elif isinstance(tick, Refusal):
                self._node.drop(APPLIED, tick.kind, tick.reason)
        return heard
