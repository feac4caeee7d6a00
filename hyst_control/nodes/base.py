"""The base of every node: an end with an exit status, signals in and out by tick, services, and the two schedules.

Two schedules, one code path. In `lockstep` a node advances whenever its inputs allow it, the plant being the clock; rows
have ticks 0, 1, 2, …, each is used once, and what was lost is asked for again by repeating the newest measurement: a node
that meets rows it knows already repeats its own newest rows. In `timer` a node ticks on the wall clock (see `tick_timer`). It then
takes what has arrived: to be called for every message would cost more than all the rest.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.task import Future
from std_srvs.srv import SetBool, Trigger

from hyst_control.errors import InputError
from hyst_control.nodes.common_parameters import COMMON, LOCKSTEP
from hyst_control.nodes.message_io import CallbackSubscription, PolledSubscription, Sender
from hyst_control.nodes.node_diagnostics import DIAGNOSTICS_INTERVAL, DiagnosticsPublisher, NodeHealth, ThrottledWarnings
from hyst_control.nodes.parameters import Setting, declare
from hyst_control.nodes.realtime_scheduling import set_scheduler
from hyst_control.nodes.signal_ports import Input, Output
from hyst_control.nodes.tick_timer import TickTimer
from hyst_control.records.signal_message import label_for
from hyst_control.records.signal_rows import Missing, SignalRows, Wait, waits


class EndingNode(Node):
    """A node that may end by itself, with an exit status, and answers services of its own."""

    SETTINGS: tuple[Setting, ...] = ()
    ends = False
    """True when the node ends by itself."""

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        self.finished = Future()
        # not _clock: that is the node's own one, which may be simulated
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)

    def close(self) -> None:
        """Release what the node holds; called on every way out."""

    def every(self, seconds: float, callback: Callable[[], None]) -> Any:
        """Call back at this interval of the steady clock."""
        return self.create_timer(seconds, callback, clock=self._steady)

    def once(self, callback: Callable[[], None]) -> None:
        """Call back once, as soon as the node spins."""

        def call() -> None:
            timer.cancel()
            callback()

        timer = self.every(1e-3, call)

    def service(self, name: str, action: Callable[[], str]) -> None:
        """Offer `~/name` (std_srvs/Trigger): the action's text is the answer, an `InputError` the reason why it failed."""

        def answer(request: Any, response: Any) -> Any:
            try:
                response.success, response.message = True, action()
            except InputError as error:
                response.success, response.message = False, str(error)
            return response

        self.create_service(Trigger, f"~/{name}", answer)

    def finish(self, publisher: Publisher, code: int = 0) -> None:
        """End the node, with this exit status, once everyone has received what the publisher sent."""
        if not self.finished.done():
            publisher.wait_for_all_acked(Duration(seconds=2))
            self.finished.set_result(code)


class SignalNode(EndingNode):
    """A node that turns signals into signals. Subclasses implement `advance` (lockstep) and `tick` (timer)."""

    def __init__(self, name: str, **options: Any) -> None:
        self.polled: list[PolledSubscription] = []
        self.receptions: list[CallbackSubscription] = []
        self.senders: list[Sender] = []
        super().__init__(name, **options)
        self.settings = declare(self, (*COMMON, *self.SETTINGS), self.changed)
        self.lockstep = self.settings.schedule == LOCKSTEP
        self.period = 1.0 / self.settings.rate_hz
        self.axes: tuple[str, ...] = self.settings.axes
        self.unit: str = self.settings.unit
        self.enabled = True
        refused = set_scheduler(self.settings.realtime_priority, self.settings.cpu)
        if refused:
            self.get_logger().warning(f"realtime_priority, cpu: {refused}: running without; see ulimit -r and nproc")
        self.inputs: list[Input] = []
        self.received: dict[str, SignalRows] = {}
        """State of all signals that the node receives, by topic."""
        self.counts: Counter[str] = Counter()
        self.tick_timer = TickTimer(self, self.period, self.settings.block)
        self._warnings = ThrottledWarnings(self)
        self._diagnostics = DiagnosticsPublisher(self)
        self._diagnosed = (time.monotonic(), 0)
        self.every(DIAGNOSTICS_INTERVAL, self._publish_diagnostics)
        self.service("reset", self._reset)
        self.service("stop", self._stop)
        self.create_service(SetBool, "~/enable", self._on_enable)

    def advance(self) -> None:
        """Lockstep: use whatever rows are there."""

    def tick(self, tick: int) -> None:
        """Timer: `block` samples from `tick` on are due; the `tick_timer.missed` ones before it were not asked for."""

    def arrived(self, source: Input, tick: int, stamp: int) -> None:
        """Timer: rows of `source` up to this tick came at this time (ns since the epoch)."""

    def repeat(self, source: Input, tick: int) -> None:
        """Lockstep: rows of `source` from this tick on were repeated; what followed from them may have been lost."""

    def out_of_order(self, source: Input, tick: int) -> None:
        """Lockstep: rows of `source` from `tick` on came while earlier ones are missing."""

    def reset(self) -> None:
        """Forget all state, as after a start."""

    def changed(self, name: str, value: Any) -> None:
        """Take over the new value of a live parameter."""

    def trouble(self) -> str:
        """Reason that keeps the node from its work, for the diagnostics; "" when there is none."""
        return ""

    def waits(self, now: float) -> list[Wait]:
        """Signals that keep the node waiting, in lockstep; now: s, monotonic clock."""
        return waits(self.received, now) if self.lockstep and not self.finished.done() else []

    def status(self) -> dict[str, Any]:
        """More entries for the diagnostics."""
        return {}

    @property
    def subscriptions(self) -> Iterator[Any]:
        """Without those that the node polls: the executor is to leave them alone."""
        own = [intake.subscription for intake in self.polled]
        yield from (each for each in super().subscriptions if not any(each is other for other in own))

    def intake(self, topic: str) -> PolledSubscription:
        """Subscribe to a topic whose messages are taken when the node asks for them."""
        self.polled.append(PolledSubscription(self, topic, self.settings.message_objects))
        return self.polled[-1]

    def signal_rows(
        self, topic: str, missing: Missing, drop_oldest: bool = False, clock_may_be_set_back: bool = False
    ) -> SignalRows:
        """State of a signal that the node receives.

        Parameters
        ----------
        topic : str
            Its topic, for the diagnostics.
        missing : Missing
            Rule for rows before which others are missing.
        drop_oldest : bool
            Drop the oldest of too many rows rather than refuse new ones.
        clock_may_be_set_back : bool
            Tell rows that go back by the parameter `backwards` from duplicates.
        """
        self.received[topic] = SignalRows(
            missing,
            self.settings.most_waiting,
            time.monotonic(),
            self.period,
            (lambda: float(self.settings.backwards)) if clock_may_be_set_back else (lambda: math.inf),
            drop_oldest,
        )
        return self.received[topic]

    def input(self, topic: str, unit: str, every_row: bool = True) -> Input:
        """Subscribe to a signal whose values have this unit; `every_row`: in lockstep, none of its rows may be skipped."""
        rows = self.signal_rows(
            topic,
            Missing.REFUSE if self.lockstep and every_row else Missing.SKIP,
            clock_may_be_set_back=not self.lockstep,
        )
        signal = Input(self, topic, label_for(self.axes, unit), rows, None if self.lockstep else self.intake(topic))
        if self.lockstep:
            self.receptions.append(CallbackSubscription(self, topic, signal.receive, signal.refused, self.settings.message_objects))
        self.inputs.append(signal)
        return signal

    def output(self, topic: str, unit: str) -> Output:
        """Publish a signal whose values have this unit."""
        self.senders.append(Sender(self, topic, label_for(self.axes, unit), self.settings.message_objects))
        return Output(self.senders[-1], len(self.axes) + 1, self.period, self.settings.block)

    def start_timer(self, phase: float) -> None:
        """Timer schedule: tick from now on, `phase` of a tick after its beginning."""
        if not self.lockstep:
            simulated = bool(self.get_parameter("use_sim_time").value)
            self.tick_timer.start(self, self.get_clock() if simulated else self._steady, phase, simulated)

    def tick_by(self, callback: Callable[[], None] | None) -> None:
        """Let the node's timer call this at every tick; None: somebody else calls `tick_timer.call`."""
        self.tick_timer.call_instead(self, self._steady, callback)

    def take_tick(self, tick: int) -> None:
        """Timer: take what has arrived, then tick."""
        for signal in self.inputs:
            signal.poll()
        self.tick(tick)

    def time_ran_backwards(self, seconds: float) -> None:
        """Begin anew: the clock was set back by so much (a simulation started again)."""
        self.counts["time ran backwards"] += 1
        self.warn("backwards", f"time ran backwards by {seconds:g} s: starting again")
        for signal in self.inputs:
            signal.forget()
        self.reset()

    def drop(self, topic: str, kind: str, reason: str) -> None:
        """Count a refused message, and say so once in a while."""
        self.counts[f"{topic}: {kind}"] += 1
        self.warn(f"{topic}: {kind}", f"{topic}: message dropped: {reason}")

    def warn(self, key: str, text: str) -> None:
        """Log one line per key and interval."""
        self._warnings.warn(key, text)

    def _reset(self) -> str:
        for signal in self.inputs:
            signal.forget()
        self.enabled = True
        self.tick_timer.overrun_streak = 0
        self.reset()
        return "reset"

    def _stop(self) -> str:
        self.enabled = False
        return "stopped: ~/enable or ~/reset goes on"

    def _on_enable(self, request: Any, response: Any) -> Any:
        self.enabled = request.data
        response.success, response.message = True, "enabled" if request.data else "disabled"
        return response

    def _publish_diagnostics(self) -> None:
        now = time.monotonic()
        ticks = max((signal.rows.end or 0 for signal in self.inputs), default=0) if self.lockstep else self.counts["ticks"]
        before, ticks_before = self._diagnosed
        self._diagnosed = (now, ticks)
        health = NodeHealth(
            trouble=self.trouble(),
            stale=[signal.topic for signal in self.inputs if not self.lockstep and signal.age > self.settings.timeout],
            rivals=[signal.topic for signal in self.inputs if self.count_publishers(signal.topic) > self.settings.most_sources],
            waits=self.waits(now),
            enabled=self.enabled,
        )
        for topic in health.rivals:
            self.warn(f"{topic}: sources", f"{topic}: {self.count_publishers(topic)} nodes publish it: was one started twice?")
        values = {
            "schedule": self.settings.schedule,
            "rate [Hz]": f"{(ticks - ticks_before) / (now - before):.1f}",
            "ticks": ticks,
            "jitter [us]": f"{self.tick_timer.jitter.take() * 1e6:.1f}",
            **health.entries,
            "handed over": ", ".join(sender.topic for sender in self.senders if sender.within) or "none",
            **{f"age of {signal.topic} [s]": f"{signal.age:.4f}" for signal in self.inputs},
            **self.tick_timer.intervals.entries("period"),
            **{key: count for key, count in self.counts.items() if key != "ticks" and count},
            **self.status(),
        }
        self._diagnostics.publish(health, values)
