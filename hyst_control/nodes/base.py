"""The base of every node: schedules, signals in and out by tick, refusal of bad messages, services and diagnostics.

Two schedules, one code path. In `lockstep` a node advances whenever its inputs allow it, the plant being the clock; rows
have ticks 0, 1, 2, …, each is used once, and what was lost is asked for again by repeating the newest measurement: a node
that meets rows it knows already repeats its own newest rows. In `timer` a node ticks on the wall clock; the tick is
floor(monotonic clock / period), a count that all processes of a machine share, so a missed tick is a visible gap. It then takes
what has arrived: to be called for every message would cost more than all the rest.
"""

from __future__ import annotations

import math
import os
import time
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.task import Future
from std_srvs.srv import SetBool, Trigger

from hyst_control.errors import InputError
from hyst_control.nodes.duration_histogram import Durations
from hyst_control.nodes.message_io import Intake, Reception, Sender
from hyst_control.nodes.parameters import Setting, declare
from hyst_control.nodes.signal_ports import Input, Output

LOCKSTEP, TIMER = "lockstep", "timer"
LONGEST_GAP = 1.0  # s, of missed ticks that are made up for
LOG_INTERVAL = 5.0  # s, between two log lines about one thing

COMMON = (
    Setting("schedule", LOCKSTEP, "", "what makes a node tick", choices=(LOCKSTEP, TIMER)),
    Setting("rate_hz", 1000.0, "Hz", "sample rate of the signals", 1e-3, 1e6),
    Setting("block", 1, "samples", "samples a message streams, and a tick of the timer covers", 1, 1_000_000),
    Setting("axes", ("x",), "", "names of the axes"),
    Setting("unit", "um", "", "unit of reference and measurement", choices=("um", "mrad")),
    Setting("timeout", 0.1, "s", "age from which an input is stale, under the timer", 1e-4, 1e3, live=True),
    Setting(
        "backwards", 1.0, "s", "an input that goes back by so much has another time: dropped, under the timer", 1e-3, 1e9, live=True
    ),
    Setting("most_sources", 1, "", "publishers of one input from which on the diagnostics warn, less one", 1, 1000, live=True),
    Setting(
        "most_waiting",
        65536,
        "rows",
        "rows of an input that wait to be used; while there are so many, new ones are refused",
        1,
        100_000_000,
    ),
    Setting("realtime_priority", 0, "", "SCHED_FIFO priority of the process, 0 for the ordinary scheduler", 0, 99),
    Setting("cpu", -1, "", "core that the process is pinned to, -1 for any", -1, 1023),
    Setting("message_objects", False, "", "exchange message objects in place of serialized bytes"),
)


class EndingNode(Node):
    """A node that may end by itself, with an exit status, and answers services of its own."""

    SETTINGS: tuple[Setting, ...] = ()
    ends = False
    """Whether the node ends by itself."""

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
        self.polled: list[Intake] = []
        self.receptions: list[Reception] = []
        self.senders: list[Sender] = []
        super().__init__(name, **options)
        self.settings = declare(self, (*COMMON, *self.SETTINGS), self.changed)
        self.lockstep = self.settings.schedule == LOCKSTEP
        self.period = 1.0 / self.settings.rate_hz
        self.axes: tuple[str, ...] = self.settings.axes
        self.unit: str = self.settings.unit
        self.enabled = True
        self._set_scheduler()
        self.inputs: list[Input] = []
        self.counts: Counter[str] = Counter()
        self._logged: dict[str, float] = {}
        self.timer: Any = None
        self._simulated = False
        self.missed = 0  # timer: samples between the tick before and this one that nobody ticked for
        self.overrun_streak = 0  # ticks in a row that took longer than their time
        self._last_tick: int | None = None
        self._ticked: float | None = None
        self._jitter = _Jitter()
        self._intervals = Durations()
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self._diagnosed = (time.monotonic(), 0)
        self.every(1.0, self._publish_diagnostics)
        self.service("reset", self._reset)
        self.service("stop", self._stop)
        self.create_service(SetBool, "~/enable", self._on_enable)

    def advance(self) -> None:
        """Lockstep: use whatever rows are there."""

    def tick(self, tick: int) -> None:
        """Timer: `block` samples from `tick` on are due; the `missed` ones before it were not asked for."""

    def arrived(self, source: Input, tick: int, stamp: int) -> None:
        """Timer: rows of `source` up to this tick came at this time (ns since the epoch)."""

    def repeat(self, source: Input, tick: int) -> None:
        """Lockstep: rows of `source` from this tick on were repeated; what followed from them may have been lost."""

    def out_of_order(self, source: Input, tick: int) -> None:
        """Lockstep: rows of `source` from `tick` on came while earlier ones are missing."""

    def reset(self) -> None:
        """Forget all state, as after a start."""

    def changed(self, name: str, value: Any) -> None:
        """A live parameter has a new value."""

    def trouble(self) -> str:
        """What keeps the node from its work, for the diagnostics; "" when nothing does."""
        return ""

    def status(self) -> dict[str, Any]:
        """More entries for the diagnostics."""
        return {}

    @property
    def subscriptions(self) -> Iterator[Any]:
        """Without those that the node polls: the executor is to leave them alone."""
        own = [intake.subscription for intake in self.polled]
        yield from (each for each in super().subscriptions if not any(each is other for other in own))

    def intake(self, topic: str) -> Intake:
        """Subscribe to a topic whose messages are taken when the node asks for them."""
        self.polled.append(Intake(self, topic, self.settings.message_objects))
        return self.polled[-1]

    def input(self, topic: str, unit: str, every_row: bool = True) -> Input:
        """Subscribe to a signal whose values have this unit; `every_row`: in lockstep, none of its rows may be skipped."""
        signal = Input(self, topic, unit, contiguous=self.lockstep and every_row)
        self.inputs.append(signal)
        return signal

    def output(self, topic: str, unit: str) -> Output:
        """Publish a signal whose values have this unit."""
        return Output(self, topic, unit)

    def start_timer(self, phase: float) -> None:
        """Timer schedule: tick from now on, `phase` of a tick after its beginning: a call a little late is the same tick."""
        if self.lockstep:
            return
        self.phase = phase
        self._simulated = self.get_parameter("use_sim_time").value
        if self._simulated:
            self.timer = self.create_timer(self.interval, self.on_timer, clock=self.get_clock())
        else:
            self.set_timer(self.on_timer)

    def set_timer(self, callback: Callable[[], None] | None) -> None:
        """Call this at every tick of the steady clock from now on; None: somebody else does."""
        if self.timer is not None:
            self.destroy_timer(self.timer)
        self.timer = None
        if callback is not None:
            time.sleep((self.phase - time.monotonic() / self.interval) % 1.0 * self.interval)
            self.timer = self.create_timer(self.interval, callback, clock=self._steady)

    @property
    def interval(self) -> float:
        """Seconds between two ticks of the timer."""
        return self.period * self.settings.block

    @property
    def paced(self) -> bool:
        """Whether the node ticks on the steady clock."""
        return self.timer is not None and not self._simulated

    def drop(self, topic: str, kind: str, reason: str) -> None:
        """Count a refused message, and say so once in a while."""
        self.counts[f"{topic}: {kind}"] += 1
        self.warn(f"{topic}: {kind}", f"{topic}: message dropped: {reason}")

    def warn(self, key: str, text: str) -> None:
        """One log line per key and interval."""
        now = time.monotonic()
        if now - self._logged.get(key, -math.inf) >= LOG_INTERVAL:
            self._logged[key] = now
            self.get_logger().warning(text)

    def _set_scheduler(self) -> None:
        """Real-time priority and core, where asked for; a system that does not allow them costs latency, nothing else."""
        try:
            if self.settings.cpu >= 0:
                os.sched_setaffinity(0, {self.settings.cpu})
            if self.settings.realtime_priority:
                os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(self.settings.realtime_priority))
        except OSError as error:
            self.get_logger().warning(f"realtime_priority, cpu: {error.strerror}: running without; see ulimit -r and nproc")

    def on_timer(self, now: float | None = None) -> None:
        """A tick is due; now: s, of the clock that paces the node."""
        if now is None:
            now = self.get_clock().now().nanoseconds * 1e-9 if self._simulated else time.monotonic()
        block = self.settings.block
        number = math.floor(now / self.interval)
        self.missed = 0
        if self._last_tick is not None:
            if number < self._last_tick - 1:
                self._time_ran_backwards(self._last_tick - number)
            elif number <= self._last_tick:
                self.counts["early calls"] += 1
                return
            else:
                skipped = number - self._last_tick - 1
                self.counts["missed ticks"] += skipped
                self.missed = min(skipped * block, round(LONGEST_GAP / self.period))
        self._last_tick = number
        if self._ticked is not None and now > self._ticked:
            self._jitter.add(now - self._ticked)
            self._intervals.add(now - self._ticked)
        self._ticked = now
        self.counts["ticks"] += 1
        for signal in self.inputs:
            signal.poll()
        self.tick(number * block)
        if not self._simulated and time.monotonic() - now > self.interval:
            self.counts["overruns"] += 1
            self.overrun_streak += 1
            self.warn("overrun", f"a tick took longer than its {self.interval * 1e3:g} ms")
        else:
            self.overrun_streak = 0

    def _time_ran_backwards(self, ticks: int) -> None:
        """The clock was set back (a simulation started again): everything begins anew."""
        self.counts["time ran backwards"] += 1
        self.warn("backwards", f"time ran backwards by {ticks * self.interval:g} s: starting again")
        for signal in self.inputs:
            signal.forget()
        self.reset()

    def _reset(self) -> str:
        for signal in self.inputs:
            signal.forget()
        self.enabled = True
        self.overrun_streak = 0
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
        stale = [signal.topic for signal in self.inputs if not self.lockstep and signal.age > self.settings.timeout]
        rivals = [signal.topic for signal in self.inputs if self.count_publishers(signal.topic) > self.settings.most_sources]
        for topic in rivals:
            self.warn(f"{topic}: sources", f"{topic}: {self.count_publishers(topic)} nodes publish it: was one started twice?")
        faults = {key: count for key, count in self.counts.items() if key != "ticks" and count}
        values = {
            "schedule": self.settings.schedule,
            "rate [Hz]": f"{(ticks - ticks_before) / (now - before):.1f}",
            "ticks": ticks,
            "jitter [us]": f"{self._jitter.take() * 1e6:.1f}",
            "stale": ", ".join(stale) or "none",
            "several sources": ", ".join(rivals) or "none",
            "enabled": self.enabled,
            "handed over": ", ".join(sender.topic for sender in self.senders if sender.within) or "none",
            **{f"age of {signal.topic} [s]": f"{signal.age:.4f}" for signal in self.inputs},
            **self._intervals.entries("period"),
            **faults,
            **self.status(),
        }
        trouble = self.trouble() or (
            f"stale: {', '.join(stale)}" if stale else f"several sources: {', '.join(rivals)}" if rivals else ""
        )
        status = DiagnosticStatus(
            name=f"{self.get_fully_qualified_name()}: loop",
            hardware_id="hyst_control",
            level=DiagnosticStatus.WARN if trouble or not self.enabled else DiagnosticStatus.OK,
            message=trouble or "running",
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(message)


class _Jitter:
    """Standard deviation of the intervals between ticks, in s, since it was last taken."""

    def __init__(self) -> None:
        self._count, self._sum, self._squares = 0, 0.0, 0.0

    def add(self, interval: float) -> None:
        self._count += 1
        self._sum += interval
        self._squares += interval * interval

    def take(self) -> float:
        count = max(self._count, 1)
        variance = self._squares / count - (self._sum / count) ** 2
        self._count, self._sum, self._squares = 0, 0.0, 0.0
        return math.sqrt(max(variance, 0.0))
