# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Status of a node: its entry in `/diagnostics`, and log lines of what it does."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.time import Time

from hyst_control.records.stream.signal_rows import Wait

DIAGNOSTICS_INTERVAL = 1.0  # s
REPORTED_WAIT = 0.1  # s; shorter waits are those of a running loop and are not reported
WAIT_WARNING = 2.0  # s; a longer wait sets the level to WARN. Lost rows are sent again long before that


@dataclass(frozen=True)
class NodeHealth:
    """State that determines the level and message of a node's diagnostics."""

    trouble: str = ""  # Fault that keeps the node from its work; "" when there is none
    stale: Sequence[str] = ()  # Inputs that are too old, under the timer
    contested: Sequence[str] = ()  # Inputs that several nodes publish
    wrong_clocks: Sequence[str] = ()  # Sources whose clock is not this node's, under the timer
    waits: Sequence[Wait] = ()  # Signals that the node is waiting for, in lockstep
    enabled: bool = True  # False after `~/stop`, and after `~/enable` with false
    slow: str = ""  # Rate that is not kept, under the timer; "" when it is
    unheard: Sequence[str] = ()  # Inputs on which nothing has come yet, under the timer

    @property
    def waiting_for(self) -> str:
        """Waits worth reporting, such as `reference@1234 (3.2 s)`, or "none"."""
        return ", ".join(str(wait) for wait in self.waits if wait.seconds >= REPORTED_WAIT) or "none"

    @property
    def entries(self) -> dict[str, Any]:
        """Entries of the diagnostics."""
        return {
            "stale": ", ".join(self.stale) or "none",
            "several sources": ", ".join(self.contested) or "none",
            "other clock": ", ".join(self.wrong_clocks) or "none",
            "waiting_for": self.waiting_for,
            "enabled": self.enabled,
        }

    @property
    def warning(self) -> str:
        """First reason for a warning; "" when there is none."""
        topics = {"other clock": self.wrong_clocks, "stale": self.stale, "several sources": self.contested}
        reasons = [self.trouble, self.slow, *(f"{what}: {', '.join(found)}" for what, found in topics.items() if found)]
        if any(wait.seconds >= WAIT_WARNING for wait in self.waits):
            reasons.append(f"waiting for {self.waiting_for}")
        return next(filter(None, reasons), "")

    @property
    def message(self) -> str:
        """State of the node in a few words."""
        if not self.enabled:
            return f"stopped: {self.warning}" if self.warning else "stopped"
        return self.warning or "running"

    @property
    def warns(self) -> bool:
        """True when the level is WARN."""
        return bool(self.warning) or not self.enabled


class NodeDiagnostics:
    """Status of a `SignalNode`: published at an interval, and logged when it changes."""

    def __init__(self, node: Any) -> None:  # SignalNode, whose module imports this one
        self._node = node
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._log = StateLog(node)
        self._last = (time.monotonic(), 0, 0)  # s, ticks and missed ones, of the last status
        self._steps: Iterator[None] = iter(())
        self._ready_since = math.inf  # s, since when the node spins
        node.once(self._say_ready)
        node.every(DIAGNOSTICS_INTERVAL, self.publish)

    def publish(self) -> None:
        """Publish the status; under the timer in steps after successive ticks, since all at once they take about a tick at 1 kHz."""
        self._finish()  # what no tick has gone on with
        ticked = self._node.counts["ticks"] > self._last[1]
        self._steps = self._in_steps()
        if ticked:
            self.go_on()
        else:
            self._finish()

    def go_on(self) -> None:
        """Do the next step of what is being published, after a tick."""
        next(self._steps, None)

    def _finish(self) -> None:
        for _ in self._steps:
            pass

    def _in_steps(self) -> Iterator[None]:
        node, schedule, now = self._node, self._node.schedule, time.monotonic()
        before, ticks_before, missed_before = self._last
        ticks, missed = schedule.ticks, node.counts["missed ticks"]
        self._last = (now, ticks, missed)
        publishers = {source.topic: node.count_publishers(source.topic) for source in node.inputs}
        seconds, new = now - before, ticks - ticks_before
        health = NodeHealth(
            trouble=node.trouble(),
            contested=[topic for topic, count in publishers.items() if count > 1],
            waits=node.waits(now),
            enabled=node.working,
            slow=schedule.slow(new, missed - missed_before, seconds) if before > self._ready_since else "",
            **schedule.health(),
        )
        for topic in health.contested:
            said = f"{publishers[topic]} nodes publish this topic: was one started twice, or killed a moment ago?"
            node.warn(f"{topic}: sources", f"{topic}: {said}")
        values: dict[str, Any] = {
            "schedule": node.settings.schedule,
            **schedule.entries(),
            "rate [Hz]": f"{new / seconds:.1f}",
            "ticks": ticks,
            "jitter [us]": f"{schedule.jitter() * 1e6:.1f}",
            **health.entries,
            "handed over": ", ".join(sender.topic for sender in node.senders if sender.within) or "none",
            **{f"age of {source.topic} [s]": f"{source.age:.4f}" for source in node.inputs},
        }
        stamp = node.get_clock().now()
        yield
        values |= schedule.intervals()
        yield
        values |= {key: count for key, count in node.counts.items() if key != "ticks" and count} | node.status()
        yield
        message = self._message(health, values, stamp)
        yield
        self._publisher.publish(message)
        if self._ready_since < now:
            self._log.tell(health)

    def _message(self, health: NodeHealth, values: Mapping[str, Any], stamp: Time) -> DiagnosticArray:
        status = DiagnosticStatus(
            name=f"{self._node.get_fully_qualified_name()}: loop",
            hardware_id="hyst_control",
            level=DiagnosticStatus.WARN if health.warns else DiagnosticStatus.OK,
            message=health.message,
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = stamp.to_msg()
        return message

    def _say_ready(self) -> None:
        node = self._node
        self._ready_since = time.monotonic()
        hears = ", ".join(node.resolve_topic_name(topic) for topic in node.received) or "nothing"
        says = ", ".join(sender.topic for sender in node.senders) or "nothing"
        node.get_logger().info(f"ready: {node.schedule.pace}; axes {', '.join(node.axes)}; hears {hears}; publishes {says}")


class StateLog:
    """Log of what a node does: a line whenever that changes."""

    def __init__(self, node: Any) -> None:  # SignalNode
        self._node = node
        self._said = ""
        self._before = ""  # As it was logged
        self._ran = False

    def tell(self, health: NodeHealth) -> None:
        """Log the state that `health` gives, unless it is the one that was logged last."""
        text, kind, waits = self._text(health)
        if kind == self._said:
            return
        self._said, before, self._before = kind, self._before, text
        logger = self._node.get_logger()
        if kind == "running":
            logger.info(f"running again, after: {before}" if self._ran else "running")
            self._ran = True
        elif waits and not self._ran:
            logger.info(text)
        else:
            logger.warning(text)

    def _text(self, health: NodeHealth) -> tuple[str, str, bool]:
        """Line of a state, what must change for another line (numbers that go on do not), and whether the node waits."""
        if health.enabled and not health.trouble:
            late = [wait for wait in health.waits if wait.seconds >= WAIT_WARNING]
            if late:
                topics = [f"{wait.topic}, tick {wait.tick}" for wait in late]
                remedies = [self._node.REMEDIES[wait.topic] for wait in late if wait.topic in self._node.REMEDIES]
                return ": ".join([f"waiting for {' and '.join(topics)}", *remedies]), _names(wait.topic for wait in late), True
            if health.unheard:
                return f"{_names(health.unheard)}: nothing has come yet", _names(health.unheard), True
        return health.message, re.sub(r"[0-9][0-9.e+-]*", "…", health.message), False


def _names(topics: Iterable[str]) -> str:
    return f"waiting for {', '.join(topics)}"
