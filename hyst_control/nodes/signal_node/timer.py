# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Schedule in which a node ticks on the wall clock, and then takes the messages that have arrived.

The tick is floor(clock / interval), counted alike by all processes of a machine, so that a missed tick is a visible gap. Messages are
polled, because one callback per message would cost more than all the rest.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

from hyst_control.nodes.signal_node.duration_histogram import Durations
from hyst_control.nodes.signal_node.message_io import LOOK_INTERVAL
from hyst_control.nodes.signal_node.signal_ports import Input, Schedule, ScheduledNode
from hyst_control.records.stream.signal_rows import Missing, Receipt

LONGEST_GAP = 1.0  # s, of missed ticks that are caught up
CLOCK_REMEDY = "a tick is floor(CLOCK_MONOTONIC / period) on one machine (docs/hardware.md)"
MISSED_SHARE = 0.01  # Share of missed ticks from which on the diagnostics warn


class Timer(Schedule):
    """Ticks a node on the steady clock or in simulated time."""

    look_interval = LOOK_INTERVAL

    def __init__(self, node: ScheduledNode, period: float, block: int, simulated: bool = False) -> None:
        super().__init__(node)
        self.interval = period * block  # Seconds between two ticks
        self.pace = f"timer, {1.0 / self.interval:g} ticks/s"
        self.phase = 0.0
        """Share of a tick after its beginning at which the node is called; a call slightly late still belongs to the same tick."""
        self.missed = 0  # Samples of the ticks that were missed between the previous tick and this one
        self.overrun_streak = 0  # Number of successive ticks that took longer than their interval
        self.simulated = simulated
        self.clocks = SourceClocks()
        self._intervals, self._jitter = Durations(), Jitter()
        self._period, self._block = period, block
        self._timer: Any = None
        self._last_tick: int | None = None
        self._last_time: float | None = None

    @property
    def paced(self) -> bool:
        """True when the node ticks on the steady clock."""
        return self._timer is not None and not self.simulated

    @property
    def now(self) -> float:
        """Time in s of the clock whose ticks the rows have: that of the machine since its start, or the simulated one."""
        return self._ros_time if self.simulated else time.monotonic()

    @property
    def offset_to_ros_time(self) -> float:
        """ROS time of that clock's zero, s."""
        return self._ros_time - self.now

    @property
    def longest_age(self) -> float:
        """Age in s from which an input is stale: the parameter `timeout`, but never less than two ticks."""
        return float(max(self._node.settings.timeout, 2.0 * self.interval))

    def start(self, phase: float) -> None:
        self.phase = phase
        if self.simulated:
            self._timer = self._node.create_timer(self.interval, self.call, clock=self._node.get_clock())
        else:
            self.call_instead(self.call)

    def call_instead(self, callback: Callable[[], None] | None) -> None:
        """Replace the function that is called at every tick of the steady clock; with None nobody calls but who calls `call`."""
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
        self._timer = None
        if callback is not None:
            time.sleep((self.phase - time.monotonic() / self.interval) % 1.0 * self.interval)
            self._timer = self._node.every(self.interval, callback)

    def call(self, now: float | None = None) -> None:
        """Tick the node at a time (s) of its clock, unless it was already called for this tick."""
        now = self.now if now is None else now
        node = self._node
        number = math.floor(now / self.interval)
        self.missed = 0
        if self._last_tick is not None:
            if number < self._last_tick - 1:
                self._start_again((self._last_tick - number) * self.interval)
            elif number <= self._last_tick:
                node.counts["early calls"] += 1
                return
            else:
                skipped = number - self._last_tick - 1
                node.counts["missed ticks"] += skipped
                self.missed = min(skipped * self._block, round(LONGEST_GAP / self._period))
        self._last_tick = number
        if self._last_time is not None and now > self._last_time:
            self._jitter.add(now - self._last_time)
            self._intervals.add(now - self._last_time)
        self._last_time = now
        node.counts["ticks"] += 1
        if node.ever_active:
            self.clocks.look_at(self.now, node.settings.ahead)
            for source in node.inputs:
                source.poll()
            node.tick(number * self._block)
        if not self.simulated and time.monotonic() - now > self.interval:
            node.counts["overruns"] += 1
            self.overrun_streak += 1
            node.warn("overrun", f"a tick took longer than its {self.interval * 1e3:g} ms")
        else:
            self.overrun_streak = 0
        node.diagnostics.go_on()

    def row_rules(self, every_row: bool, replace: bool) -> dict[str, Any]:
        return {"missing": Missing.SKIP, "clock_may_be_set_back": True, "replace": replace}

    def heard(self, topic: str, newest: float) -> None:
        self.clocks.now = self.now
        self.clocks.heard(topic, newest)

    def far_ahead(self, topic: str, end: int) -> bool:
        self.clocks.heard(topic, (end - 1) * self._period)
        return end * self._period > self.clocks.latest

    def is_due(self, time: float) -> bool:
        return bool(time <= self.now + self._node.settings.ahead)

    def accepted(self, source: Input, tick: int, stamp: int, lost: int) -> None:
        if lost:
            self._node.counts[f"{source.topic}: lost"] += lost
        self._node.arrived(source, tick, stamp)

    def came_again(self, source: Input, receipt: Receipt) -> None:
        self._node.counts[f"{source.topic}: {'late' if receipt is Receipt.LATE else 'duplicate'}"] += 1

    @property
    def ticks(self) -> int:
        return int(self._node.counts["ticks"])

    def health(self) -> dict[str, Any]:
        node = self._node
        wrong = self.clocks.look(self.longest_age, node.settings.ahead)
        for topic, seconds in wrong.items():
            side = "ahead of" if seconds > 0 else "behind"
            node.warn(f"{topic}: clock", f"{topic}: its times are {abs(seconds):.4g} s {side} this node's clock: {CLOCK_REMEDY}")
        return {
            "wrong_clocks": list(wrong),
            "stale": [source.topic for source in node.inputs if source.age > node.settings.timeout],
            "unheard": [source.topic for source in node.inputs if source.needed and source.rows.end is None],
        }

    def slow(self, ticks: int, missed: int, seconds: float) -> str:
        if missed <= MISSED_SHARE * (ticks + missed):
            return ""
        return f"{ticks / seconds:.0f} of {1.0 / self.interval:.0f} Hz: {missed} ticks missed"

    def entries(self) -> dict[str, str]:
        return {
            "offset to ROS time [s]": f"{self.offset_to_ros_time:.6f}",
            **self.clocks.entries(),
            "set rate [Hz]": f"{1.0 / self.interval:.1f}",
        }

    def jitter(self) -> float:
        return self._jitter.take()

    def intervals(self) -> dict[str, str]:
        return self._intervals.entries("period")

    @property
    def _ros_time(self) -> float:
        return float(self._node.get_clock().now().nanoseconds * 1e-9)

    def _start_again(self, seconds: float) -> None:
        """Begin anew after the clock was set back, as by a restarted simulation."""
        node = self._node
        node.counts["time ran backwards"] += 1
        node.warn("backwards", f"time ran backwards by {seconds:g} s: starting again")
        for source in node.inputs:
            source.forget()
        node.reset()


class SourceClocks:
    """Differences between the times of received rows and the clock, each the smallest since the last look."""

    def __init__(self) -> None:
        self.now, self.latest = 0.0, math.inf
        self._least: dict[str, float] = {}
        self._told: dict[str, float] = {}

    def look_at(self, now: float, most_ahead: float) -> None:
        """Set the time for the messages that are taken next."""
        self.now, self.latest = now, now + most_ahead

    def heard(self, topic: str, newest: float) -> None:
        """Count a message."""
        ahead = newest - self.now
        known = self._least.get(topic)
        if known is None or abs(ahead) < abs(known):
            self._least[topic] = ahead

    def look(self, behind: float, ahead: float) -> dict[str, float]:
        """Sources whose rows were all older than `behind` or further ahead than `ahead`, both in s, since the last look."""
        self._told, self._least = self._least, {}
        return {topic: found for topic, found in self._told.items() if not -behind <= found <= ahead}

    def entries(self) -> dict[str, str]:
        """Entries of the diagnostics, as of the last look."""
        return {f"clock of {topic} [s]": f"{found:.4f}" for topic, found in self._told.items()}


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
