"""Timer schedule: ticks of the wall clock, counted alike by all processes of a machine, and statistics of their timing.

The tick is floor(clock / interval), so that a missed tick is a visible gap.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable
from typing import Any, Protocol

from rclpy.clock import Clock
from rclpy.node import Node

from hyst_control.nodes.signal_node.duration_histogram import Durations

LONGEST_GAP = 1.0  # s, of missed ticks that are caught up


class TickOwner(Protocol):
    """Node as seen by its timer; `SignalNode` documents the methods."""

    counts: Counter[str]

    def take_tick(self, tick: int) -> None:
        """Take the messages that have arrived, then tick."""

    def after_tick(self) -> None:
        """Do what has time until the next tick."""

    def time_ran_backwards(self, seconds: float) -> None:
        """Start again after the clock was set back by so many `seconds`."""

    def warn(self, key: str, text: str) -> None:
        """Log a warning `text`, at most once per interval for each `key`."""


class TickTimer:
    """Timer that ticks a node on the steady clock or in simulated time."""

    def __init__(self, owner: TickOwner, period: float, block: int) -> None:
        self.period, self.block = period, block
        self.interval = period * block
        """Seconds between two ticks."""
        self.phase = 0.0
        """Share of a tick after its beginning at which the node is called; a call slightly late still belongs to the same tick."""
        self.missed = 0
        """Samples of the ticks that were missed between the previous tick and this one."""
        self.overrun_streak = 0
        """Number of successive ticks that took longer than their interval."""
        self.intervals, self.jitter = Durations(), Jitter()
        self._owner = owner
        self._timer: Any = None
        self._simulated = False
        self._last_tick: int | None = None
        self._last_time: float | None = None
        self._now: Callable[[], float] = time.monotonic

    @property
    def paced(self) -> bool:
        """True when the node ticks on the steady clock."""
        return self._timer is not None and not self._simulated

    @property
    def now(self) -> float:
        """Time in s of the clock that paces the node."""
        return self._now()

    def start(self, node: Node, clock: Clock, phase: float, simulated: bool) -> None:
        """Start ticking."""
        self.phase, self._simulated = phase, simulated
        if simulated:
            self._now = lambda: float(clock.now().nanoseconds * 1e-9)
            self._timer = node.create_timer(self.interval, self.call, clock=clock)
        else:
            self.call_instead(node, clock, self.call)

    def call_instead(self, node: Node, clock: Clock, callback: Callable[[], None] | None) -> None:
        """Replace the function that the timer calls at every tick of the steady clock."""
        if self._timer is not None:
            node.destroy_timer(self._timer)
        self._timer = None
        if callback is not None:
            time.sleep((self.phase - time.monotonic() / self.interval) % 1.0 * self.interval)
            self._timer = node.create_timer(self.interval, callback, clock=clock)

    def call(self, now: float | None = None) -> None:
        """Tick the node, unless it was already called for this tick."""
        now = self._now() if now is None else now
        owner = self._owner
        number = math.floor(now / self.interval)
        self.missed = 0
        if self._last_tick is not None:
            if number < self._last_tick - 1:
                owner.time_ran_backwards((self._last_tick - number) * self.interval)
            elif number <= self._last_tick:
                owner.counts["early calls"] += 1
                return
            else:
                skipped = number - self._last_tick - 1
                owner.counts["missed ticks"] += skipped
                self.missed = min(skipped * self.block, round(LONGEST_GAP / self.period))
        self._last_tick = number
        if self._last_time is not None and now > self._last_time:
            self.jitter.add(now - self._last_time)
            self.intervals.add(now - self._last_time)
        self._last_time = now
        owner.counts["ticks"] += 1
        owner.take_tick(number * self.block)
        if not self._simulated and time.monotonic() - now > self.interval:
            owner.counts["overruns"] += 1
            self.overrun_streak += 1
            owner.warn("overrun", f"a tick took longer than its {self.interval * 1e3:g} ms")
        else:
            self.overrun_streak = 0
        owner.after_tick()


class Jitter:
    """Standard deviation of the intervals (s) between ticks."""

    def __init__(self) -> None:
        self._count, self._sum, self._squares = 0, 0.0, 0.0

    def add(self, interval: float) -> None:
        """Count an interval."""
        self._count += 1
        self._sum += interval
        self._squares += interval * interval

    def take(self) -> float:
        """Standard deviation in s since the last call."""
        count = max(self._count, 1)
        variance = self._squares / count - (self._sum / count) ** 2
        self._count, self._sum, self._squares = 0, 0.0, 0.0
        return math.sqrt(max(variance, 0.0))
