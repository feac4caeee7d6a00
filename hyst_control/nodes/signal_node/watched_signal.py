# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Signal that a node only listens to, polled in both schedules: rows with their ticks."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.nodes.signal_node.base import SignalNode
from hyst_control.records.stream.foreign_rows import OFF_THE_CLOCK, admissible, off_the_clock, refused_values
from hyst_control.records.stream.signal_message import label_for
from hyst_control.records.stream.signal_rows import Missing, Receipt, successive_parts


class WatchedSignal:
    """One signal whose rows are taken in order of their ticks, each once.

    When more than `most_waiting` rows wait for the other signal, the oldest ones are dropped.
    """

    def __init__(self, node: SignalNode, topic: str, unit: str, restarted: Callable[[], None], sparse: bool = False) -> None:
        self._node, self._topic, self._restarted, self._sparse = node, topic, restarted, sparse
        self._label = label_for(node.axes, unit)
        self._intake = node.intake(topic)
        self.rows = node.signal_rows(topic, Missing.SKIP, drop_oldest=True, clock_may_be_set_back=True, sparse=sparse)

    def drain(self) -> None:
        """Take all messages that have arrived."""
        for label, block, _ in self._intake.take(partial(self._node.drop, self._topic, "unreadable"), merge=True):
            if label != self._label:
                self._node.drop(self._topic, "wrong label", f"its columns must be {self._label!r}, got {label!r}")
            else:
                self.receive(block)

    def receive(self, block: Annotated[Array, "N 1 + A"]) -> None:
        """Take in the rows of one or several messages."""
        for tick, part in successive_parts(block, self._node.period):
            if tick is None:
                self._node.drop(self._topic, OFF_THE_CLOCK, off_the_clock(self._node.period))
                continue
            usable = admissible(part)
            if usable.all():
                self._receive_rows(tick, part[:, 1:].copy())  # the message is read-only
            else:
                self._node.drop(self._topic, *refused_values(part))
                for stretch in np.split(np.arange(len(part)), np.flatnonzero(np.diff(usable)) + 1):
                    if usable[stretch[0]]:
                        self._receive_rows(tick + int(stretch[0]), part[stretch, 1:])

    def _receive_rows(self, tick: int, rows: Array) -> None:
        node, state = self._node, self.rows
        missed, dropped, now = state.missed, state.dropped, time.monotonic()
        receipt = state.receive(tick, rows, now)
        if receipt is Receipt.CLOCK_RESET:
            node.counts["time ran backwards"] += 1
            self._restarted()
            state.receive(tick, rows, now)
        elif receipt is Receipt.AHEAD:
            node.drop(self._topic, "far ahead", f"tick {state.end} is next, got {tick}: does its source use the same clock?")
        elif receipt is not Receipt.ACCEPTED:
            node.counts[f"{self._topic}: duplicate"] += 1
        elif state.missed > missed and not self._sparse:
            node.counts[f"{self._topic}: missed ticks"] += state.missed - missed
        if state.dropped > dropped and not self._sparse:
            node.drop(self._topic, "too many waiting", f"{state.available} rows are waiting for the other signal: has it stopped?")
