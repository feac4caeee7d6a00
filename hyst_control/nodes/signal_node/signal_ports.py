# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Received and published signals of a node: bad messages are refused, rows go by tick, the newest ones are kept for repetition."""

from __future__ import annotations

import math
import time
from collections import Counter
from types import SimpleNamespace
from typing import Annotated, Any

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.nodes.execution.ending_node import EndingNode
from hyst_control.nodes.signal_node.message_io import PolledSubscription, Sender
from hyst_control.nodes.signal_node.node_diagnostics import NodeDiagnostics
from hyst_control.records.stream.foreign_rows import Refusal, admit
from hyst_control.records.stream.row_repetition import SentRows
from hyst_control.records.stream.signal_rows import Receipt, SignalRows, Wait

REPEATED_ROWS = 64
"""Rows per repeated message, or as many as the node streams: every slot of the middleware's queues is as large as the longest message."""

LOG_INTERVAL = 5.0  # s, between two log lines with the same key


class Schedule:
    """Says when a node is called, and what becomes of the rows that it receives; this one knows no clock and waits for nothing."""

    pace = ""  # Schedule in words
    look_interval = 0.0  # s, between two looks of a sender for subscribers beyond the process

    def __init__(self, node: ScheduledNode) -> None:
        self._node = node

    @property
    def ticks(self) -> int:
        """Ticks so far, for the diagnostics."""
        return 0

    def start(self, phase: float) -> None:
        """Begin to call the node, at a share of a tick after its beginning."""

    def resume(self) -> None:
        """Go on after a standstill."""

    def row_rules(self, every_row: bool, replace: bool) -> dict[str, Any]:
        """Rules for the rows of an input: arguments of `SignalNode.signal_rows`."""
        return {}

    def heard(self, topic: str, newest: float) -> None:
        """Hold the time (s) of a source's newest row against the clock; for messages that no input takes."""

    def far_ahead(self, topic: str, end: int) -> bool:
        """True when rows up to the tick `end` cannot be there yet."""
        return False

    def is_due(self, time: float) -> bool:
        """True when the clock has come to a row of this time (s), so that it may follow on a long silence."""
        return False

    def accepted(self, source: Input, tick: int, stamp: int, lost: int) -> None:
        """Use new rows up to `tick`, received at `stamp` (ns since the epoch), before which so many were `lost`."""

    def came_again(self, source: Input, receipt: Receipt) -> None:
        """Count rows of ticks that were there before."""

    def waits(self, now: float) -> list[Wait]:
        """Signals that the node is waiting for at a time (s) of the monotonic clock."""
        return []

    def health(self) -> dict[str, Any]:
        """Fields of `NodeHealth` about clocks and ages."""
        return {}

    def slow(self, ticks: int, missed: int, seconds: float) -> str:
        """Rate that is not kept, "" when it is."""
        return ""

    def entries(self) -> dict[str, str]:
        """Entries of the diagnostics about clocks."""
        return {}

    def jitter(self) -> float:
        """Standard deviation in s of the intervals between ticks, since the last call."""
        return 0.0

    def intervals(self) -> dict[str, str]:
        """Entries of the diagnostics about the intervals between ticks."""
        return {}


class ScheduledNode(EndingNode):
    """Node as its inputs and its schedule see and call it."""

    counts: Counter[str]
    inputs: list[Input]
    received: dict[str, SignalRows]  # State of every received signal, by topic
    settings: SimpleNamespace
    period: float
    diagnostics: NodeDiagnostics
    schedule: Schedule
    ever_active = True  # False until a node with managed states is activated: before that it publishes nothing
    _warned: dict[str, float]  # s, when it was, by key

    def advance(self) -> None:
        """Use the rows that are available, in lockstep."""

    def tick(self, tick: int) -> None:
        """Produce `block` samples, under the timer; the `timer.missed` samples before them were not requested."""

    def arrived(self, source: Input, tick: int, stamp: int) -> None:
        """Take note of the time at which rows arrived, under the timer."""

    def repeat(self, source: Input, tick: int) -> None:
        """Publish again the rows that followed from repeated ones, which may have been lost, in lockstep."""

    def out_of_order(self, source: Input, tick: int) -> None:
        """React to rows that arrived while earlier ones are missing, in lockstep."""

    def reset(self) -> None:
        """Return to the state after a start."""

    def drop(self, topic: str, kind: str, reason: str) -> None:
        """Count a refused message, and log it at most once per interval."""
        self.counts[f"{topic}: {kind}"] += 1
        self.warn(f"{topic}: {kind}", f"{topic}: message dropped: {reason}")

    def warn(self, key: str, text: str) -> None:
        """Log a warning, at most one per `key` and `LOG_INTERVAL`."""
        now = time.monotonic()
        if now - self._warned.get(key, -math.inf) >= LOG_INTERVAL:
            self._warned[key] = now
            self.get_logger().warning(text)


class Input:
    """One subscribed signal: checks its messages, keeps their rows and informs the schedule."""

    def __init__(self, owner: ScheduledNode, topic: str, label: str, rows: SignalRows, needed: bool = True) -> None:
        self.topic, self.label, self.rows = topic, label, rows
        self.needed = needed  # False when the node works without the signal, under the timer
        self.intake: PolledSubscription | None = None  # Subscription from which `poll` takes messages, under the timer
        self._owner = owner
        self._seen_label: str | None = None

    def poll(self) -> None:
        """Take the messages that have arrived, under the timer."""
        if self.intake is not None:
            for label, block, stamp in self.intake.take(self.refused):
                self.receive(label, block, stamp)

    def refused(self, reason: str) -> None:
        """Count a message that cannot be read."""
        self._owner.drop(self.topic, "unreadable", reason)

    def receive(self, label: str, block: Annotated[Array, "N 1 + A"], stamp: int = 0) -> None:
        """Take in a message, received at `stamp`, ns since the epoch; its rows may be read-only."""
        owner, rows = self._owner, self.rows
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
        end = tick + len(block)
        if owner.schedule.far_ahead(self.topic, end):
            owner.drop(
                self.topic,
                "far ahead",
                "its time is ahead of the clock by more than the parameter ahead: does its source use the same clock?",
            )
            return
        missed = rows.missed
        receipt = rows.receive(tick, block[:, 1:].copy(), time.monotonic())  # the message is read-only
        if receipt is Receipt.ACCEPTED:
            owner.schedule.accepted(self, end - 1, stamp, rows.missed - missed)
        else:
            self._not_accepted(receipt, tick)

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
        elif receipt is Receipt.REPLACED:
            owner.counts[f"{self.topic}: replaced"] += 1
        else:
            if receipt is Receipt.CONFLICT:
                owner.drop(self.topic, "conflict", f"tick {tick} came twice with different values: do two nodes publish it?")
            owner.schedule.came_again(self, receipt)


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
        block = np.empty((len(rows), self._columns))
        block[:, 0] = np.arange(tick, tick + len(rows)) * self._period
        block[:, 1:] = rows
        return block
