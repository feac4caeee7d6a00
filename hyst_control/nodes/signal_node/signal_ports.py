"""Received and published signals of a node: bad messages are refused, rows go by tick, the newest ones are kept for repetition."""

from __future__ import annotations

import time
from collections import Counter
from typing import Annotated, Protocol

import numpy as np
from numpy.typing import NDArray

from hyst_control.nodes.signal_node.message_io import PolledSubscription, Sender
from hyst_control.nodes.signal_node.source_clocks import SourceClocks
from hyst_control.records.foreign_rows import Refusal, admit
from hyst_control.records.row_repetition import SentRows
from hyst_control.records.signal_rows import Receipt, SignalRows

Array = NDArray[np.float64]

REPEATED_ROWS = 64
"""Rows per repeated message, or as many as the node streams: every slot of the middleware's queues is as large as the longest message."""


class InputOwner(Protocol):
    """Node as seen by its inputs; `SignalNode` documents the methods."""

    counts: Counter[str]
    lockstep: bool
    period: float
    source_clocks: SourceClocks

    def drop(self, topic: str, kind: str, reason: str) -> None:
        """Count a refused message of a `topic` by its `kind`, and log the `reason` at most once per interval."""

    def advance(self) -> None:
        """Use the rows that are available, in lockstep."""

    def arrived(self, source: Input, tick: int, stamp: int) -> None:
        """Store the time `stamp` at which rows of a `source` up to `tick` arrived, under the timer."""

    def repeat(self, source: Input, tick: int) -> None:
        """Publish again, in lockstep, the rows that followed from the repeated rows of a `source`, which begin at `tick`."""

    def out_of_order(self, source: Input, tick: int) -> None:
        """React, in lockstep, to rows of a `source` that begin at `tick` while earlier ones are missing."""


class Input:
    """One subscribed signal: checks its messages, keeps their rows and informs the node."""

    def __init__(
        self, owner: InputOwner, topic: str, label: str, rows: SignalRows, intake: PolledSubscription | None = None
    ) -> None:
        self.topic, self.label, self.rows = topic, label, rows
        self.needed = True
        """False when the node works without the signal, under the timer."""
        self._owner, self._intake = owner, intake
        self._seen_label: str | None = None

    def poll(self) -> None:
        """Take the messages that have arrived, under the timer."""
        if self._intake is not None:
            for label, block, stamp in self._intake.take(self.refused):
                self.receive(label, block, stamp)

    def refused(self, reason: str) -> None:
        """Count a message that cannot be read."""
        self._owner.drop(self.topic, "unreadable", reason)

    def receive(self, label: str, block: Annotated[Array, "N 1 + A"], stamp: int = 0) -> None:
        """Take in a message."""
        owner = self._owner
        if label is not self._seen_label:
            if label != self.label:
                owner.drop(self.topic, "wrong label", f"its columns must be {self.label!r}, got {label!r}")
                return
            self._seen_label = label
        if not len(block):
            return
        tick = admit(block, owner.period)
        if isinstance(tick, Refusal):
            owner.drop(self.topic, tick.kind, tick.reason)
            return
        lockstep, end = owner.lockstep, tick + len(block)
        if not lockstep:
            clocks = owner.source_clocks
            clocks.heard(self.topic, (end - 1) * owner.period)
            if end * owner.period > clocks.latest:
                owner.drop(
                    self.topic,
                    "far ahead",
                    "its time is ahead of the clock by more than the parameter ahead: does its source use the same clock?",
                )
                return
        rows = self.rows
        missed = rows.missed
        receipt = rows.receive(tick, block[:, 1:].copy(), time.monotonic())  # the message is read-only
        if receipt is not Receipt.ACCEPTED:
            self._not_accepted(receipt, tick)
        elif lockstep:
            owner.advance()
        else:
            if rows.missed > missed:
                owner.counts[f"{self.topic}: lost"] += rows.missed - missed
            owner.arrived(self, end - 1, stamp)

    def forget(self) -> None:
        """Start again; the next rows may have any tick."""
        self.rows.forget()

    @property
    def age(self) -> float:
        """Seconds since the newest rows arrived, or since the start."""
        return time.monotonic() - self.rows.arrived

    def _not_accepted(self, receipt: Receipt, tick: int) -> None:
        """Count refused and known rows, and inform the node."""
        owner, rows = self._owner, self.rows
        if receipt is Receipt.JOINING:
            owner.counts[f"{self.topic}: joining"] += 1
        elif receipt is Receipt.GAP:
            owner.drop(self.topic, "out of order", f"tick {rows.end} must come next, got {tick}")
            owner.out_of_order(self, tick)
        elif receipt is Receipt.FULL:
            owner.drop(
                self.topic,
                "too many waiting",
                f"{rows.available} rows are waiting to be used: has another input stopped, or is the time of this one ahead? "
                "A longer lead needs a greater most_waiting",
            )
        elif receipt is Receipt.AHEAD:
            owner.drop(self.topic, "far ahead", f"tick {rows.end} is next, got {tick}: does its source use the same clock?")
        elif receipt is Receipt.CLOCK_RESET:
            owner.drop(
                self.topic,
                "time ran backwards",
                f"tick {tick} comes after tick {(rows.end or 0) - 1}: call ~/reset to accept the new time",
            )
        elif receipt is Receipt.LATE and not owner.lockstep:
            owner.counts[f"{self.topic}: late"] += 1
        elif receipt is Receipt.REPLACED:
            owner.counts[f"{self.topic}: replaced"] += 1
        else:
            owner.counts[f"{self.topic}: duplicate"] += 1
            if receipt is Receipt.CONFLICT:
                owner.drop(self.topic, "conflict", f"tick {tick} came twice with different values: do two nodes publish it?")
            if owner.lockstep:
                oldest = rows.repetition_due(time.monotonic())
                if oldest is not None:
                    owner.repeat(self, oldest)


class Output:
    """One published signal, whose newest rows are kept for repetition."""

    def __init__(self, sender: Sender, columns: int, period: float, block: int) -> None:
        self.sender, self.publisher = sender, sender.publisher
        self.sent = SentRows()
        self._columns, self._period, self._block = columns, period, block

    def send(self, tick: int, rows: Annotated[Array, "N A"]) -> None:
        """Publish rows."""
        block = self.with_times(tick, rows)
        self.sender.send(block)
        self.sent.add(tick, block)

    def repeat(self, first: int = 0) -> None:
        """Publish kept rows again; the newest message when none of them are kept."""
        rows = self.sent.since(first)
        if rows is None:
            self.repeat_newest()
        else:
            self._send_in_parts(rows)

    def repeat_rows(self, tick: int, rows: Annotated[Array, "N A"]) -> None:
        """Publish rows again that the caller has kept."""
        self._send_in_parts(self.with_times(tick, rows))

    def repeat_newest(self) -> None:
        """Publish the newest message again."""
        if self.sent.newest is not None:
            self.sender.send(self.sent.newest)

    def clear(self) -> None:
        """Forget the kept rows."""
        self.sent.clear()

    def _send_in_parts(self, block: Array) -> None:
        step = max(REPEATED_ROWS, self._block)
        for begin in range(0, len(block), step):
            self.sender.send(block[begin : begin + step])

    def with_times(self, tick: int, rows: Annotated[Array, "N A"]) -> Annotated[Array, "N 1 + A"]:
        """Rows of successive ticks with their times."""
        count, period = len(rows), self._period
        block = np.empty((count, self._columns))
        if count == 1:
            block[0, 0] = tick * period
        else:
            block[:, 0] = np.arange(tick, tick + count) * period
        block[:, 1:] = rows
        return block
