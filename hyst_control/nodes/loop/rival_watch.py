# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Watch over a topic that a node publishes itself, for others that publish it too.

As long as the node is its only publisher nothing is received. Once there are several, the node listens, and what it hears and has not
sent is a rival's.
"""

from __future__ import annotations

import math
import time
from collections import OrderedDict

from hyst_control.base.arrays import Array
from hyst_control.nodes.signal_node.base import SignalNode
from hyst_control.nodes.signal_node.message_io import PolledSubscription
from hyst_control.nodes.signal_node.signal_ports import Output
from hyst_control.records.stream.foreign_rows import Refusal, admit

LOOK_INTERVAL = 0.02  # s, between two looks at the number of publishers and at what they have sent
SENT_ROWS = 100_000  # Own rows that are remembered while there are several publishers


class RivalWatch:
    """Watch over one published signal."""

    def __init__(self, node: SignalNode, output: Output, label: str) -> None:
        self.newest: Array | None = None  # Newest row (A,) of a rival, V
        self._node, self._output, self._label = node, output, label
        self._heard = -math.inf
        self._intake: PolledSubscription | None = None
        self._sent: OrderedDict[bytes, None] = OrderedDict()
        node.every(LOOK_INTERVAL, self.look)

    @property
    def silent_for(self) -> float:
        """Seconds since a rival was heard."""
        return time.monotonic() - self._heard

    @property
    def listening(self) -> bool:
        """True while there are several publishers."""
        return self._intake is not None

    def sent(self, block: Array) -> None:
        """Remember the rows of a `block` (N, 1 + A) that the node sends, while there are several publishers."""
        if self._intake is not None:
            self._sent.update(dict.fromkeys(row.tobytes() for row in block))
            while len(self._sent) > SENT_ROWS:
                self._sent.popitem(last=False)

    def look(self) -> None:
        """Listen while there are several publishers, and take what has come."""
        others = self._node.count_publishers(self._output.publisher.topic_name) > 1
        if others and self._intake is None:
            self._intake = self._node.intake(self._output.publisher.topic_name)
            kept = self._output.sent.since(0)  # may be sent again
            if kept is not None:
                self.sent(kept)
        elif not others and self._intake is not None:
            self._take()
            self._node.end_intake(self._intake)
            self._intake = None
            self._sent.clear()
        if self._intake is not None:
            self._take()

    def _take(self) -> None:
        assert self._intake is not None
        for label, block, _ in self._intake.take(lambda reason: None):
            foreign = [row for row in block if row.tobytes() not in self._sent]
            if foreign and label == self._label and not isinstance(admit(block, self._node.period), Refusal):  # others nobody takes
                self._heard = time.monotonic()
                self.newest = foreign[-1][1:].copy()
