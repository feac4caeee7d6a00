# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""State of a running loop as a page shows it: written by one thread, read by others."""

from __future__ import annotations

import re
import threading
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array

SETBACK = 0.5  # s by which a time goes back when a loop was started anew; less is a row that came twice
LOST_AFTER = 5.0  # s after which a node that says nothing is called lost: diagnostics come once a second
MAX_EVENTS = 200  # Events that are kept
NUMBER = re.compile(r"[0-9][0-9.e+-]*")


@dataclass(frozen=True)
class LoopEvent:
    """A fault that a node's diagnostics report, or the end of it; `when` in s since the epoch."""

    when: float
    node: str
    words: str
    fault: bool


@dataclass(frozen=True)
class NodeState:
    """Newest diagnostics of a node."""

    name: str
    warns: bool  # its level is not OK
    message: str
    values: Mapping[str, str] = field(default_factory=dict)  # entries by key
    heard: float = 0.0  # s, monotonic clock

    @property
    def lost(self) -> bool:
        """True when the node has been silent for long."""
        return time.monotonic() - self.heard > LOST_AFTER

    @property
    def fault(self) -> str:
        """The node's trouble in a few words; "" when it has none."""
        return "silent" if self.lost else self.message if self.warns else ""

    @property
    def rate(self) -> tuple[float, float] | None:
        """Ticks per second, and those that it should make (NaN in lockstep); None for a node that does not tick."""
        if self.lost or self.values.get("ticks", "0") == "0":
            return None
        return float(self.values.get("rate [Hz]", "nan")), float(self.values.get("set rate [Hz]", "nan"))


class Trace:
    """Newest rows of a table that grows, for readers that ask for what came since they last looked."""

    def __init__(self, window: float) -> None:
        self.window = window
        self.columns: tuple[str, ...] = ()  # Names of the columns, the time first
        self.epoch = 0  # Number of times that the table began anew
        self._lock = threading.Lock()
        self._blocks: deque[tuple[int, Array]] = deque()  # index of the first row, rows
        self._end = 0
        self._newest = -np.inf
        self._arrived = -np.inf

    @property
    def age(self) -> float:
        """Seconds since the newest rows arrived; infinite before the first."""
        return time.monotonic() - self._arrived

    def add(self, columns: tuple[str, ...], rows: Annotated[Array, "N C"]) -> None:
        """Append rows; those that are not newer than the newest one are left out."""
        if not len(rows):
            return
        with self._lock:
            if columns != self.columns or rows[-1, 0] < self._newest - SETBACK:
                self.columns, self._newest = columns, -np.inf
                self._blocks.clear()
                self.epoch += 1
            rows = rows[rows[:, 0] > self._newest].copy()
            if len(rows):
                self._blocks.append((self._end, rows))
                self._end += len(rows)
                self._newest, self._arrived = float(rows[-1, 0]), time.monotonic()
            while self._blocks and self._blocks[0][1][-1, 0] < self._newest - self.window:
                self._blocks.popleft()

    def since(self, epoch: int, index: int) -> tuple[int, int, Array]:
        """Rows that a reader has not seen."""
        with self._lock:
            first = index if epoch == self.epoch else 0
            parts = [rows[max(first - begin, 0) :] for begin, rows in self._blocks if begin + len(rows) > first]
            empty = np.zeros((0, max(len(self.columns), 1)))
            return self.epoch, self._end, np.concatenate(parts) if parts else empty


class LiveState:
    """All that a page shows of a loop."""

    def __init__(self, window: float = 10.0) -> None:
        self.signals = Trace(window)  # Signals over time, decimated
        self.gap = Trace(6.0 * window)  # Gap of every judged window, in % of the range, and its alarm (0 or 1)
        self.answers: deque[str] = deque(maxlen=5)  # Requests to the nodes and their answers, the newest last
        self.events: deque[LoopEvent] = deque(maxlen=MAX_EVENTS)  # Faults of the nodes and their ends, the newest last
        self._faults: dict[str, tuple[str, float]] = {}  # of each node: its fault with "…" for numbers, and since when
        self._lock = threading.Lock()
        self._turn: tuple[tuple[str, ...], Array] = ((), np.zeros((0, 1)))
        self._nodes: dict[str, NodeState] = {}

    @property
    def turn(self) -> tuple[tuple[str, ...], Array]:
        """Names of the columns and rows (N, C) of the newest stretch, for the loop."""
        with self._lock:
            return self._turn

    def set_turn(self, columns: tuple[str, ...], rows: Annotated[Array, "N C"]) -> None:
        """Replace the newest stretch."""
        with self._lock:
            self._turn = columns, rows.copy()

    @property
    def nodes(self) -> list[NodeState]:
        """Newest diagnostics of every node, by name."""
        with self._lock:
            return [self._nodes[name] for name in sorted(self._nodes)]

    def set_node(self, node: NodeState) -> None:
        """Replace the diagnostics of a node, and note what has changed."""
        with self._lock:
            before = self._nodes.get(node.name)
            self._nodes[node.name] = node
        if before is not None and not (before.warns or node.warns):
            brief = int(node.values.get("faults", 0)) - int(before.values.get("faults", 0))
            if brief > 0:
                self._note(node.name, f"{brief} fault{'s' * (brief > 1)}, over within a second", fault=True)
        self._compare(node)

    def forget_node(self, name: str) -> None:
        """Show the node `name` no more, as it was ended on purpose."""
        with self._lock:
            self._nodes.pop(name, None)
            self._faults.pop(name, None)

    def look(self) -> None:
        """Note which nodes have fallen silent."""
        for node in self.nodes:
            self._compare(node)

    def _compare(self, node: NodeState) -> None:
        """Note a fault that is not the one of before: numbers that go on make no other one."""
        now = time.time()
        before, since = self._faults.get(node.name, ("", now))
        kind = NUMBER.sub("…", node.fault)
        if kind != before:
            self._faults[node.name] = kind, now
            self._note(node.name, node.fault or f"{node.message} again, after {now - since:.1f} s", bool(kind))

    def _note(self, name: str, words: str, fault: bool) -> None:
        self.events.append(LoopEvent(time.time(), name, words, fault))
