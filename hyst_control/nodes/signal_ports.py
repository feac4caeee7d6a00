"""A node's signals in and out: bad messages refused, rows by tick, the newest ones kept to be repeated."""

from __future__ import annotations

import math
import time
from collections import Counter
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hyst_control.nodes.message_io import PolledSubscription, Sender
from hyst_control.records.row_repetition import SentRows
from hyst_control.records.signal_rows import Receipt, SignalRows, first_tick, tick_at

Array = NDArray[np.float64]

REPEATED_ROWS = 64
"""In one message, or as many as the node streams: the middleware's queues keep room for the longest message in each of their places."""


class InputOwner(Protocol):
    """Node as its inputs see it: they tell it what has come."""

    counts: Counter[str]
    lockstep: bool
    period: float

    def drop(self, topic: str, kind: str, reason: str) -> None:
        """Count a refused message, and say so once in a while."""

    def advance(self) -> None:
        """Lockstep: use whatever rows are there."""

    def arrived(self, source: Input, tick: int, stamp: int) -> None:
        """Timer: rows of `source` up to this tick came at this time (ns since the epoch)."""

    def repeat(self, source: Input, tick: int) -> None:
        """Lockstep: rows of `source` from this tick on were repeated; what followed from them may have been lost."""

    def out_of_order(self, source: Input, tick: int) -> None:
        """Lockstep: rows of `source` from `tick` on came while earlier ones are missing."""


class Input:
    """One subscribed signal: what its messages are worth, told to the node, and the rows that they brought.

    Parameters
    ----------
    owner : InputOwner
        The node.
    topic, label : str
        Topic, and the column label that its messages must have.
    rows : SignalRows
        State of the signal.
    intake : PolledSubscription, optional
        Timer: where messages are taken by `poll`.
    """

    def __init__(
        self, owner: InputOwner, topic: str, label: str, rows: SignalRows, intake: PolledSubscription | None = None
    ) -> None:
        self.topic, self.label, self.rows = topic, label, rows
        self._owner, self._intake = owner, intake
        self._seen_label: str | None = None

    def poll(self) -> None:
        """Timer: take what has arrived."""
        if self._intake is not None:
            for label, block, stamp in self._intake.take(self.refused):
                self.receive(label, block, stamp)

    def refused(self, reason: str) -> None:
        """Count a message that cannot be read."""
        self._owner.drop(self.topic, "unreadable", reason)

    def receive(self, label: str, block: Array, stamp: int = 0) -> None:
        """Take in a message.

        Parameters
        ----------
        label : str
            Its column label.
        block : ndarray, shape (N, 1 + A)
            Its rows, column 0 the time in s; may be read-only.
        stamp : int
            Time of reception in ns since the epoch.
        """
        owner = self._owner
        if label is not self._seen_label:
            if label != self.label:
                owner.drop(self.topic, "wrong label", f"its columns must be {self.label!r}, got {label!r}")
                return
            self._seen_label = label
        if not len(block):
            return
        values = block.ravel().tolist()
        if not all(map(math.isfinite, values)):
            owner.drop(self.topic, "not finite", "it holds a NaN or an infinity")
            return
        tick = tick_at(values[0], owner.period) if len(block) == 1 else first_tick(block, owner.period)
        if tick is None:
            owner.drop(self.topic, "off the clock", off_the_clock(owner.period))
            return
        missed = self.rows.missed
        receipt = self.rows.receive(tick, block[:, 1:].copy(), time.monotonic())  # the message is read-only
        if receipt is not Receipt.ACCEPTED:
            self._not_accepted(receipt, tick)
        elif owner.lockstep:
            owner.advance()
        else:
            if self.rows.missed > missed:
                owner.counts[f"{self.topic}: lost"] += self.rows.missed - missed
            owner.arrived(self, tick + len(block) - 1, stamp)

    def forget(self) -> None:
        """Begin anew: the next rows may have any tick."""
        self.rows.forget()

    @property
    def age(self) -> float:
        """Seconds since the newest rows arrived, or since the start."""
        return time.monotonic() - self.rows.arrived

    def _not_accepted(self, receipt: Receipt, tick: int) -> None:
        """Count rows that were refused or known, and do what follows from it."""
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
                f"{rows.available} rows wait to be used: does another input stand still, or is "
                "the time of this one ahead? A lead may be longer with a greater most_waiting",
            )
        elif receipt is Receipt.CLOCK_RESET:
            owner.drop(
                self.topic, "time ran backwards", f"tick {tick} comes after tick {(rows.end or 0) - 1}: ~/reset takes the new time"
            )
        elif receipt is Receipt.LATE and not owner.lockstep:
            owner.counts[f"{self.topic}: late"] += 1
        else:
            owner.counts[f"{self.topic}: duplicate"] += 1
            if receipt is Receipt.CONFLICT:
                owner.drop(self.topic, "conflict", f"tick {tick} came twice, with other values: do two nodes publish it?")
            if owner.lockstep:
                oldest = rows.repetition_due(time.monotonic())
                if oldest is not None:
                    owner.repeat(self, oldest)


class Output:
    """One published signal; the newest rows are kept to be repeated.

    Parameters
    ----------
    sender : Sender
        Publisher of the topic.
    columns : int
        Number of columns of a message: the time and one per axis.
    period : float
        Time in s between two ticks.
    block : int
        Rows that the node streams in one message.
    """

    def __init__(self, sender: Sender, columns: int, period: float, block: int) -> None:
        self.sender, self.publisher = sender, sender.publisher
        self.sent = SentRows()
        self._columns, self._period, self._block = columns, period, block

    def send(self, tick: int, rows: Array) -> None:
        """Publish rows (N, A) of the ticks from `tick` on."""
        block = self._with_times(tick, rows)
        self.sender.send(block)
        self.sent.add(tick, block)

    def repeat(self, first: int = 0) -> None:
        """Publish the rows from this tick on again, as far back as they are kept; the newest message when there are none."""
        rows = self.sent.since(first)
        if rows is None:
            self.repeat_newest()
        else:
            self._send_in_parts(rows)

    def repeat_rows(self, tick: int, rows: Array) -> None:
        """Publish rows (N, A) of the ticks from `tick` on, which were published before."""
        self._send_in_parts(self._with_times(tick, rows))

    def repeat_newest(self) -> None:
        """Publish the newest message again."""
        if self.sent.newest is not None:
            self.sender.send(self.sent.newest)

    def clear(self) -> None:
        """Forget the rows that were kept."""
        self.sent.clear()

    def _send_in_parts(self, block: Array) -> None:
        step = max(REPEATED_ROWS, self._block)
        for begin in range(0, len(block), step):
            self.sender.send(block[begin : begin + step])

    def _with_times(self, tick: int, rows: Array) -> Array:
        """Rows (N, A) of the ticks from `tick` on with their times, (N, 1 + A)."""
        count, period = len(rows), self._period
        block = np.empty((count, self._columns))
        if count == 1:
            block[0, 0] = tick * period
        else:
            block[:, 0] = np.arange(tick, tick + count) * period
        block[:, 1:] = rows
        return block


def off_the_clock(period: float) -> str:
    """Reason why a message is refused whose times are no ticks of this period (s)."""
    return f"its times are not successive multiples of the period {period:g} s: is rate_hz the same everywhere?"
