"""Two signals watched side by side: rows of the same ticks, from messages that are taken when it suits, in both schedules."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hyst_control.nodes.signal_ports import tick_of
from hyst_control.records.signal_message import label_for

if TYPE_CHECKING:
    from hyst_control.nodes.base import SignalNode

Array = NDArray[np.float64]
Ticks = NDArray[np.int64]


class Watched:
    """One signal: rows with their ticks, in order and each once. `restarted` is called when its time begins anew.

    While more than `most_waiting` rows wait for the other signal, the oldest of them are dropped.
    """

    def __init__(self, node: SignalNode, topic: str, unit: str, restarted: Callable[[], None]) -> None:
        self._node, self._topic, self._restarted = node, topic, restarted
        self._label = label_for(node.axes, unit)
        self._intake = node.intake(topic)
        self.forget()

    def forget(self) -> None:
        """The next rows may have any tick."""
        self.end: int | None = None
        self.arrived = 0
        self._blocks: deque[tuple[Ticks, Array]] = deque()
        self.waiting = 0

    def drain(self) -> None:
        """Take everything that has arrived."""
        for label, block, _ in self._intake.take(self._refused, merge=True):
            if label != self._label:
                self._node.drop(self._topic, "wrong label", f"its columns are {label!r}, {self._label!r} is due")
                continue
            steps = np.diff(block[:, 0]) / self._node.period
            for part in np.split(block, np.flatnonzero(~(np.abs(steps - 1.0) < 1e-3)) + 1):
                self._receive(part)

    def take(self, end: int) -> tuple[Ticks, Array]:
        """Ticks (N,) and rows (N, A) before this tick; they are used up."""
        if not self._blocks:
            return np.zeros(0, np.int64), np.zeros((0, len(self._node.axes)))
        ticks, rows = (np.concatenate(parts) for parts in zip(*self._blocks, strict=True))
        cut = int(np.searchsorted(ticks, end))
        self._blocks, self.waiting = deque([(ticks[cut:], rows[cut:])]), len(ticks) - cut
        return ticks[:cut], rows[:cut]

    def _refused(self, reason: str) -> None:
        self._node.drop(self._topic, "unreadable", reason)

    def _receive(self, block: Array) -> None:
        node = self._node
        if not len(block):
            return
        tick = tick_of(block, node.period) if np.isfinite(block[:, 0]).all() else None
        if tick is None:
            node.drop(
                self._topic,
                "off the clock",
                f"its times are not successive multiples of the period {node.period:g} s: is rate_hz the same everywhere?",
            )
            return
        finite = np.isfinite(block).all(axis=1)
        if not finite.all():
            node.drop(self._topic, "not finite", "it holds a NaN or an infinity")
            for part in np.split(block, np.flatnonzero(np.diff(finite)) + 1):
                if np.isfinite(part).all():
                    self._receive(part)
            return
        end = tick + len(block)
        if self.end is not None:
            if (self.end - end) * node.period >= node.settings.backwards:
                node.counts["time ran backwards"] += 1
                self._restarted()
            elif end <= self.end:
                node.counts[f"{self._topic}: duplicate"] += 1
                return
            else:
                node.counts[f"{self._topic}: missed ticks"] += max(tick - self.end, 0)
                tick, block = max(tick, self.end), block[max(self.end - tick, 0) :]
        self.end = end
        self.arrived += len(block)
        self._blocks.append((np.arange(tick, end), block[:, 1:].copy()))  # the message is read-only
        self.waiting += len(block)
        while self.waiting - len(self._blocks[0][0]) >= node.settings.most_waiting:
            node.drop(
                self._topic, "too many waiting", f"{self.waiting} rows wait for their pair: does the other signal stand still?"
            )
            self.waiting -= len(self._blocks.popleft()[0])
