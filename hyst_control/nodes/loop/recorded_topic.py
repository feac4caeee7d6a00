# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""One topic of a recorder: every row once, by tick, although messages may be duplicated, late or lost."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.nodes.signal_node.base import SignalNode
from hyst_control.records.stream.foreign_rows import OFF_THE_CLOCK, off_the_clock
from hyst_control.records.stream.signal_message import Encoder
from hyst_control.records.stream.signal_rows import Missing, Receipt, successive_parts


class RecordedTopic:
    """One recorded topic and the ticks that are stored of it.

    Rows are held back until it is known that no earlier ones are missing; rows after a gap, until it is filled or given up.
    """

    def __init__(
        self,
        node: SignalNode,
        topic: str,
        store: Callable[[str, bytes, int], None],
        repeated: Callable[[], None],
        merge: int = 1,
        ticks: int = 0,
        sparse: bool = False,
    ) -> None:
        self._node, self._store, self._repeated, self._merge, self._sparse = node, store, repeated, merge, sparse
        self._ticks = ticks if node.lockstep else 0
        self._encoder: Encoder | None = None
        self.rows = node.signal_rows(topic, Missing.HOLD if node.lockstep else Missing.SKIP, sparse=sparse)
        self._missed = 0  # Ticks given up that were counted
        self.recorded = 0  # Number of rows taken for the bag
        self._pending: list[Array] = []  # blocks (N, C) of successive ticks that are merged into one message
        self._pending_rows = 0
        self._pending_end = 0  # tick after the last of them
        self._stamp = 0  # ns, of the reception of the newest rows
        self._intake = node.intake(topic)
        self.name = self._intake.topic

    def drain(self) -> None:
        """Take all messages that have arrived."""
        for label, block, stamp in self._intake.take(partial(self._node.drop, self.name, "unreadable"), self._merge > 1):
            self._stamp = stamp
            self.receive(label, block)
        self.rows.release(time.monotonic())
        self._count_missed()
        self._collect()

    def receive(self, label: str, block: Annotated[Array, "N C"]) -> None:
        """Take in the rows of one or several messages."""
        if self._encoder is None or label != self._encoder.label:
            try:
                encoder = Encoder(label)
            except InputError as error:
                self._node.drop(self.name, "wrong label", str(error))
                return
            if self._encoder is not None:
                self.close()
            self._encoder = encoder
        if not len(block):
            self._node.drop(self.name, OFF_THE_CLOCK, off_the_clock(self._node.period))
        for tick, part in successive_parts(block, self._node.period):
            if tick is None:
                self._node.drop(self.name, OFF_THE_CLOCK, off_the_clock(self._node.period))
                continue
            if self._ticks:
                part = part[: max(self._ticks - tick, 0)]
            if len(part):
                self._node.schedule.heard(self.name, float(part[-1, 0]))
                self._receive_rows(tick, part)

    def write(self) -> None:
        """Store the rows that are waiting to be merged."""
        if self._pending and self._encoder is not None:
            rows = self._pending[0] if len(self._pending) == 1 else np.concatenate(self._pending)
            self._pending, self._pending_rows = [], 0
            self._store(self.name, self._encoder.encode(rows), self._stamp)

    def close(self) -> None:
        """Store all received rows, those held back as well."""
        self.rows.release(time.monotonic(), give_up=True)
        self._count_missed()
        self._collect()
        self.write()

    def _receive_rows(self, tick: int, block: Array) -> None:
        """Take in rows (N, C) of successive ticks from this one on."""
        receipt = self.rows.receive(tick, block, time.monotonic())
        self._count_missed()
        if receipt is Receipt.ACCEPTED:
            self._collect()
        elif receipt is Receipt.AHEAD:
            self._node.drop(
                self.name, "far ahead", f"tick {self.rows.end} is next, got {tick}: does its source use the same clock?"
            )
        elif receipt is not Receipt.HELD:
            self._node.counts[f"{self.name}: duplicate"] += 1
            if self._node.lockstep:
                self._repeated()

    def _count_missed(self) -> None:
        """Count the ticks given up since the last call."""
        before, self._missed = self._missed, self.rows.missed
        if self._missed > before and not self._sparse:
            self._node.counts[f"{self.name}: missed ticks"] += self._missed - before
            if self._node.lockstep:
                first, end = self.rows.gaps[-1]
                self._node.warn(self.name, f"{self.name}: ticks {first} to {end - 1} are lost: was their node killed?")

    def _collect(self) -> None:
        """Merge the available rows into messages of successive rows."""
        for tick, block in self.rows.take_blocks():
            if tick != self._pending_end:
                self.write()
            self._pending.append(block)
            self._pending_rows += len(block)
            self._pending_end = tick + len(block)
            self.recorded += len(block)
            if self._pending_rows >= self._merge:
                self.write()
