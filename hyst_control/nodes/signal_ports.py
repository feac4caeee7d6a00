"""A node's signals in and out: bad messages refused, rows by tick, the newest ones kept to be repeated."""

from __future__ import annotations

import math
import time
from collections import deque
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hyst_control.nodes.message_io import Reception, Sender
from hyst_control.nodes.rows import DUPLICATE, FULL, GAP, Rows
from hyst_control.records.signal_message import label_for

if TYPE_CHECKING:
    from hyst_control.nodes.base import SignalNode

Array = NDArray[np.float64]

KEPT_ROWS, KEPT_BLOCKS = 4096, 8
MOST_LOST = 1024  # lost ticks that are remembered, to know them when they come late
REPEAT_INTERVAL, LONGEST_INTERVAL = 0.02, 0.5
"""s, between two repetitions, and for which nothing new must have come: what goes on lacks nothing, and of two sources of one signal,
which bring every tick twice, each repetition would cause others. Twice as long after each that brought nothing, up to the longest."""
LONGEST_JOINING = 2.0  # s, for which a newly heard signal is waited to be repeated
REPEATED_ROWS = 64
"""In one message, or as many as the node streams: the middleware's queues keep room for the longest message in each of their places."""


class Joining:
    """Whether a newly heard signal is heard from its first row on, in lockstep.

    Who is discovered while rows are being sent hears the later ones only, and would go on without those before. So rows count from
    tick 0 on, or from where they are repeated from: as long as somebody lacks rows the run stands still, and all are sent again.
    """

    def __init__(self) -> None:
        self._first: int | None = None
        self._since = 0.0  # s, monotonic clock

    def complete(self, tick: int) -> bool:
        """Whether rows from this tick on, which have just come, may be the first ones."""
        now = time.monotonic()
        if self._first is None:
            self._first, self._since = tick, now
            return tick == 0
        return tick <= self._first or now - self._since > LONGEST_JOINING  # of a run that goes on nothing is repeated


class Input:
    """One subscribed signal: rows by tick, and what is known about its health."""

    def __init__(self, node: SignalNode, topic: str, unit: str, contiguous: bool) -> None:
        self.node, self.topic = node, topic
        self.label = label_for(node.axes, unit)
        self.rows = Rows(contiguous, node.settings.most_waiting)
        self.arrived, self._repeated = time.monotonic(), -math.inf  # s, monotonic clock
        self._patience = REPEAT_INTERVAL
        self._again = math.inf  # oldest tick that came again since new rows came or a repetition
        self.conflicted = -math.inf  # s, monotonic clock: when two sources disagreed last
        self._seen_label: str | None = None
        self._newest: tuple[int, Array] | None = None  # rows that came last, and the tick of the first of them
        self._lost: deque[int] = deque(maxlen=MOST_LOST)
        self._joining = Joining()
        if node.lockstep:
            node.receptions.append(Reception(node, topic, self._receive, self._refused, node.settings.message_objects))
        else:
            self._intake = node.intake(topic)

    def poll(self) -> None:
        """Timer: take what has arrived."""
        if not self.node.lockstep:
            for label, block, stamp in self._intake.take(self._refused):
                self._receive(label, block, stamp)

    def _refused(self, reason: str) -> None:
        self.node.drop(self.topic, "unreadable", reason)

    def _receive(self, label: str, block: Array, stamp: int = 0) -> None:
        node = self.node
        if label is not self._seen_label:
            if label != self.label:
                node.drop(self.topic, "wrong label", f"its columns are {label!r}, {self.label!r} is due")
                return
            self._seen_label = label
        if not len(block):
            return
        if not all(map(math.isfinite, block.ravel().tolist())):
            node.drop(self.topic, "not finite", "it holds a NaN or an infinity")
            return
        tick = tick_of(block, node.period)
        if tick is None:
            node.drop(
                self.topic,
                "off the clock",
                f"its times are not successive multiples of the period {node.period:g} s: is rate_hz the same everywhere?",
            )
            return
        due, rows = self.rows.end, block[:, 1:].copy()  # the message is read-only
        if due is None and self.rows.contiguous and not self._joining.complete(tick):
            node.counts[f"{self.topic}: joining"] += 1
            return
        outcome = self.rows.append(tick, rows)
        if outcome is DUPLICATE:
            self._seen_before(tick, rows)
            return
        if outcome is GAP:
            node.drop(self.topic, "out of order", f"tick {self.rows.end} is due, {tick} came")
            node.out_of_order(self, tick)
            return
        if outcome is FULL:
            node.drop(
                self.topic,
                "too many waiting",
                f"{self.rows.available} rows wait to be used: does another input stand still, or is "
                "the time of this one ahead? A lead may be longer with a greater most_waiting",
            )
            return
        self.arrived = time.monotonic()
        self._patience, self._again = REPEAT_INTERVAL, math.inf
        self._newest = tick, rows
        if node.lockstep:
            node.advance()
            return
        if due is not None and tick > due:
            node.counts[f"{self.topic}: lost"] += tick - due
            self._lost.extend(range(max(due, tick - MOST_LOST), tick))
        node.arrived(self, tick + len(block) - 1, stamp)

    def forget(self) -> None:
        """Begin anew: the next rows may have any tick."""
        self.rows.clear()
        self._newest = None
        self._lost.clear()
        self._joining = Joining()
        self.conflicted = -math.inf

    def _seen_before(self, tick: int, rows: Array) -> None:
        """Rows of ticks that were there: a repetition, a late one, a second source, or a clock that was set back."""
        node, end = self.node, tick + len(rows)
        if (self.rows.end - end) * node.period >= node.settings.backwards and not node.lockstep:
            node.drop(
                self.topic, "time ran backwards", f"tick {tick} comes after tick {self.rows.end - 1}: ~/reset takes the new time"
            )
            return
        if not node.lockstep and tick in self._lost:
            node.counts[f"{self.topic}: late"] += 1
            return
        node.counts[f"{self.topic}: duplicate"] += 1
        if self._contradicts(tick, rows):
            self.conflicted = time.monotonic()
            node.drop(self.topic, "conflict", f"tick {tick} came twice, with other values: do two nodes publish it?")
        now = time.monotonic()
        self._again = min(tick, self._again)
        if node.lockstep and now - max(self._repeated, self.arrived) > self._patience:  # in the middle of a burst, maybe
            self._repeated, self._patience = now, min(2 * self._patience, LONGEST_INTERVAL)
            oldest, self._again = int(self._again), math.inf
            node.repeat(self, oldest)

    def _contradicts(self, tick: int, rows: Array) -> bool:
        """Whether these rows differ from those that came last in a tick that both have."""
        if self._newest is None:
            return False
        first, newest = self._newest
        begin, end = max(first, tick), min(first + len(newest), tick + len(rows))
        return begin < end and not np.array_equal(rows[begin - tick : end - tick], newest[begin - first : end - first])

    @property
    def age(self) -> float:
        """Seconds since the newest rows arrived, or since the start."""
        return time.monotonic() - self.arrived


class Output:
    """One published signal; the newest rows, KEPT_ROWS and KEPT_BLOCKS messages at least, are kept to be repeated."""

    def __init__(self, node: SignalNode, topic: str, unit: str) -> None:
        self._node = node
        self._columns = len(node.axes) + 1
        self._sender = Sender(node, topic, label_for(node.axes, unit), node.settings.message_objects)
        self._kept: deque[Array] = deque()
        self._kept_rows = 0
        self._end = 0
        node.senders.append(self._sender)
        self.publisher = self._sender.publisher

    def block(self, tick: int, rows: Array) -> Array:
        """Rows (N, A) of the ticks from `tick` on with their times, (N, 1 + A)."""
        count, period = len(rows), self._node.period
        block = np.empty((count, self._columns))
        if count == 1:
            block[0, 0] = tick * period
        else:
            block[:, 0] = np.arange(tick, tick + count) * period
        block[:, 1:] = rows
        return block

    def send(self, tick: int, rows: Array) -> None:
        """Publish rows (N, A) of the ticks from `tick` on."""
        count = len(rows)
        block = self.block(tick, rows)
        self._sender.send(block)
        if tick != self._end:
            self.clear()  # what is kept are successive ticks
        self._end = tick + count
        self._kept.append(block)
        self._kept_rows += count
        while self._kept_rows - len(self._kept[0]) >= KEPT_ROWS and len(self._kept) > KEPT_BLOCKS:
            self._kept_rows -= len(self._kept.popleft())

    def repeat(self, first: int = 0) -> None:
        """Publish the rows from this tick on again, as far back as they are kept; the newest message when there are none."""
        begin = max(first - (self._end - self._kept_rows), 0)
        if begin >= self._kept_rows:
            self.repeat_newest()
        else:
            self.send_again(np.concatenate(self._kept)[begin:])

    def send_again(self, block: Array) -> None:
        """Publish a block (N, C) that was published before, column 0 the time."""
        step = max(REPEATED_ROWS, self._node.settings.block)
        for begin in range(0, len(block), step):
            self._sender.send(block[begin : begin + step])

    def repeat_newest(self) -> None:
        """Publish the newest message again."""
        if self._kept:
            self._sender.send(self._kept[-1])

    def clear(self) -> None:
        """Forget the rows that were kept."""
        self._kept.clear()
        self._kept_rows = 0


def tick_of(block: Array, period: float) -> int | None:
    """Tick of the first row of a block (N, C), or None when its times are not successive multiples of the period (s)."""
    first = float(block[0, 0]) / period
    tick = round(first)
    if abs(first - tick) > 1e-3 or tick < 0:
        return None
    rows = len(block)
    if rows > 1 and np.max(np.abs(block[:, 0] / period - np.arange(tick, tick + rows))) > 1e-3:
        return None
    return tick
