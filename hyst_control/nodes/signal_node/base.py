"""Base class of the nodes that turn signals into signals: rows in and out by tick, diagnostics, and the two schedules.

Two schedules, one code path. In `lockstep` a node advances whenever its inputs allow it; the plant is the clock. Rows have the ticks
0, 1, 2, … and each is used once. Lost rows are requested by repeating the newest measurement: a node that receives rows it already
has repeats its own newest rows. In `timer` a node ticks on the wall clock (see `tick_timer`) and then takes the messages that have
arrived, because one callback per message would cost more than all the rest.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from types import SimpleNamespace
from typing import Any

from rclpy.subscription import Subscription
from std_srvs.srv import SetBool

from hyst_control.nodes.execution.ending_node import EndingNode
from hyst_control.nodes.execution.tick_timer import TickTimer
from hyst_control.nodes.signal_node.common_parameters import COMMON, LOCKSTEP
from hyst_control.nodes.signal_node.message_io import LOOK_INTERVAL, CallbackSubscription, PolledSubscription, Sender
from hyst_control.nodes.signal_node.node_diagnostics import (
    DIAGNOSTICS_INTERVAL,
    DiagnosticsPublisher,
    NodeHealth,
    StateLog,
    ThrottledWarnings,
)
from hyst_control.nodes.signal_node.parameters import Setting, declare
from hyst_control.nodes.signal_node.signal_ports import Input, Output
from hyst_control.nodes.signal_node.source_clocks import CLOCK_REMEDY, SourceClocks, describe
from hyst_control.processes.realtime_scheduling import set_scheduler
from hyst_control.records.signal_message import label_for
from hyst_control.records.signal_rows import Missing, SignalRows, Wait, waits

MISSED_SHARE = 0.01
"""Share of missed ticks from which on the diagnostics warn."""


class SignalNode(EndingNode):
    """Node that turns signals into signals. Subclasses implement `advance` (lockstep) and `tick` (timer)."""

    COMMON_SETTINGS = COMMON
    REMEDIES: Mapping[str, str] = {}
    """Remedies for a topic that does not come, by topic."""

    def __init__(self, name: str, **options: Any) -> None:
        self.polled: list[PolledSubscription] = []
        self.receptions: list[CallbackSubscription] = []
        self.senders: list[Sender] = []
        super().__init__(name, **options)
        self.settings = declare(
            self, (*COMMON, *self.SETTINGS), self.changed, self.check_change, self.further_settings, self.elsewhere
        )
        self.lockstep = self.settings.schedule == LOCKSTEP
        self.period = 1.0 / self.settings.rate_hz
        self.axes: tuple[str, ...] = self.settings.axes
        self.unit: str = self.settings.unit
        self.enabled = True
        refused = set_scheduler(self.settings.realtime_priority, self.settings.cpu)
        if refused:
            self.get_logger().warning(f"realtime_priority, cpu: {refused}: the node runs without them; see ulimit -r and nproc")
        self.inputs: list[Input] = []
        self.received: dict[str, SignalRows] = {}
        """State of every received signal, by topic."""
        self.counts: Counter[str] = Counter()
        self.tick_timer = TickTimer(self, self.period, self.settings.block)
        self._simulated = bool(self.get_parameter("use_sim_time").value)
        self.source_clocks = SourceClocks()
        self._warnings = ThrottledWarnings(self)
        self._diagnostics = DiagnosticsPublisher(self)
        self._state_log = StateLog(self, self.REMEDIES)
        self._diagnosed = (time.monotonic(), 0, 0)
        self._telling: Iterator[None] = iter(())
        self._ready_since = math.inf  # s, since when the node spins
        self.once(self._say_ready)
        self.every(DIAGNOSTICS_INTERVAL, self._publish_diagnostics)
        self.service("reset", self._reset)
        self.service("stop", self._stop)
        self.create_service(SetBool, "~/enable", self._on_enable)

    def advance(self) -> None:
        """Use the rows that are available, in lockstep."""

    def tick(self, tick: int) -> None:
        """Produce `block` samples, under the timer; the `tick_timer.missed` samples before them were not requested."""

    def arrived(self, source: Input, tick: int, stamp: int) -> None:
        """Take note of the time at which rows arrived, under the timer."""

    def repeat(self, source: Input, tick: int) -> None:
        """Publish again the rows that followed from repeated ones, which may have been lost, in lockstep."""

    def out_of_order(self, source: Input, tick: int) -> None:
        """React to rows that arrived while earlier ones are missing, in lockstep."""

    def reset(self) -> None:
        """Return to the state after a start."""

    def changed(self, name: str, value: Any) -> None:
        """Take over the new value of a live parameter."""

    def further_settings(self, given: SimpleNamespace) -> Iterable[Setting]:
        """Parameters of the node besides `SETTINGS`, which depend on those that were given."""
        return ()

    def check_change(self, values: Mapping[str, Any]) -> None:
        """Refuse values of live parameters that cannot be taken over, by an `InputError` with the reason."""

    @property
    def working(self) -> bool:
        """False while the node was told to stop."""
        return self.enabled

    def trouble(self) -> str:
        """Fault that keeps the node from its work, for the diagnostics; "" when there is none."""
        return ""

    @property
    def control_time(self) -> float:
        """Time in s of the clock whose ticks the rows have, under the timer: that of the machine since its start, or the simulated one."""
        return self.ros_time if self._simulated else time.monotonic()

    @property
    def ros_time(self) -> float:
        """ROS time, s."""
        return float(self.get_clock().now().nanoseconds * 1e-9)

    @property
    def offset_to_ros_time(self) -> float:
        """ROS time of the control clock's zero, s."""
        return self.ros_time - self.control_time

    def heard(self, topic: str, newest: float) -> None:
        """Compare a source's clock with this node's, under the timer; for messages that are not taken by a tick."""
        if not self.lockstep:
            self.source_clocks.now = self.control_time
            self.source_clocks.heard(topic, newest)

    def is_due(self, time: float) -> bool:
        """True when a row of this time (s) is no further ahead of the clock than the parameter `ahead` allows, under the timer."""
        return not self.lockstep and time <= self.control_time + float(self.settings.ahead)

    @property
    def longest_age(self) -> float:
        """Age in s from which an input is stale, under the timer: the parameter `timeout`, but never less than two ticks."""
        return float(max(self.settings.timeout, 2.0 * self.tick_timer.interval))

    def waits(self, now: float) -> list[Wait]:
        """Signals that the node is waiting for, in lockstep."""
        return waits(self.received, now) if self.lockstep and not self.finished.done() else []

    def status(self) -> dict[str, Any]:
        """Further entries of the diagnostics, by key."""
        return {}

    @property
    def subscriptions(self) -> Iterator[Subscription]:
        """Subscriptions that the executor serves: all but those that the node polls."""
        own = [intake.subscription for intake in self.polled]
        yield from (each for each in super().subscriptions if not any(each is other for other in own))

    def intake(self, topic: str) -> PolledSubscription:
        """Subscribe to a topic whose messages are taken when the node asks for them."""
        self.polled.append(PolledSubscription(self, topic, self.settings.message_objects))
        return self.polled[-1]

    def end_intake(self, intake: PolledSubscription) -> None:
        """End a subscription that `intake` made."""
        self.polled.remove(intake)
        self.destroy_subscription(intake.subscription)

    def signal_rows(
        self,
        topic: str,
        missing: Missing,
        drop_oldest: bool = False,
        clock_may_be_set_back: bool = False,
        replace: bool = False,
        sparse: bool = False,
    ) -> SignalRows:
        """Create the state of a signal that the node receives."""
        self.received[topic] = SignalRows(
            missing,
            self.settings.most_waiting,
            time.monotonic(),
            self.period,
            (lambda: float(self.settings.backwards)) if clock_may_be_set_back else (lambda: math.inf),
            drop_oldest,
            replace,
            (lambda end: self.is_due((end - 1) * self.period)) if sparse else (lambda end: False),
        )
        return self.received[topic]

    def input(self, topic: str, unit: str, every_row: bool = True, replace: bool = False) -> Input:
        """Subscribe to a signal."""
        # every_row: refuse rows that skip earlier ones, in lockstep; False also means that under the timer the node works without
        # the signal
        rows = self.signal_rows(
            topic,
            Missing.REFUSE if self.lockstep and every_row else Missing.SKIP,
            clock_may_be_set_back=not self.lockstep,
            replace=replace and not self.lockstep,
        )
        signal = Input(self, topic, label_for(self.axes, unit), rows, None if self.lockstep else self.intake(topic))
        signal.needed = every_row
        if self.lockstep:
            self.receptions.append(CallbackSubscription(self, topic, signal.receive, signal.refused, self.settings.message_objects))
        self.inputs.append(signal)
        return signal

    def output(self, topic: str, unit: str) -> Output:
        """Create the publisher of a signal."""
        look = 0.0 if self.lockstep else LOOK_INTERVAL
        self.senders.append(Sender(self, topic, label_for(self.axes, unit), self.settings.message_objects, look))
        return Output(self.senders[-1], len(self.axes) + 1, self.period, self.settings.block)

    def start_timer(self, phase: float) -> None:
        """Start ticking under the timer; without effect in lockstep."""
        if not self.lockstep:
            self.tick_timer.start(self, self.get_clock() if self._simulated else self._steady, phase, self._simulated)

    def tick_by(self, callback: Callable[[], None] | None) -> None:
        """Set the function that the node's timer calls at every tick."""
        self.tick_timer.call_instead(self, self._steady, callback)

    def take_tick(self, tick: int) -> None:
        """Take the messages that have arrived, then tick, under the timer."""
        self.source_clocks.look_at(self.tick_timer.now, self.settings.ahead)
        for signal in self.inputs:
            signal.poll()
        self.tick(tick)

    def after_tick(self) -> None:
        """Do what has time until the next tick, under the timer."""
        next(self._telling, None)

    def time_ran_backwards(self, seconds: float) -> None:
        """Start again after the clock was set back, as by a restarted simulation."""
        self.counts["time ran backwards"] += 1
        self.warn("backwards", f"time ran backwards by {seconds:g} s: starting again")
        for signal in self.inputs:
            signal.forget()
        self.reset()

    def drop(self, topic: str, kind: str, reason: str) -> None:
        """Count a refused message, and log it at most once per interval."""
        self.counts[f"{topic}: {kind}"] += 1
        self.warn(f"{topic}: {kind}", f"{topic}: message dropped: {reason}")

    def warn(self, key: str, text: str) -> None:
        """Log a warning, at most one per key and interval."""
        self._warnings.warn(key, text)

    def look_at_slope(self, found: tuple[int, float] | None) -> None:
        """Warn of a reference that asks for more slope than the parameter `slew_limit`, at a tick by so many V a tick."""
        if found:
            tick, step = found
            self.counts["slope above slew_limit"] += 1
            self.warn(
                "slope",
                f"the reference asks for {step / self.period:.3g} V/s at {tick * self.period:.6g} s, slew_limit is "
                f"{self.settings.slew_limit:g} V/s: smooth the reference, or begin it with a ramp",
            )

    def _reset(self) -> str:
        for signal in self.inputs:
            signal.forget()
        self.enabled = True
        self.tick_timer.overrun_streak = 0
        self.reset()
        return "reset"

    def _stop(self) -> str:
        self.enabled = False
        return "stopped: call ~/enable or ~/reset to continue"

    def _on_enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self.enabled = request.data
        if self.lockstep:
            self.once(self.advance)
        response.success, response.message = True, "enabled" if request.data else "disabled"
        return response

    def _publish_diagnostics(self) -> None:
        """Publish the diagnostics; under the timer in steps after successive ticks, since all at once they take about a tick at 1 kHz."""
        self._tell()  # what no tick has gone on with
        ticks = not self.lockstep and self.counts["ticks"] > self._diagnosed[1]
        self._telling = self._diagnostics_in_steps()
        if ticks:
            next(self._telling, None)
        else:
            self._tell()

    def _tell(self) -> None:
        """Go on with the diagnostics that are being published to their end."""
        for _ in self._telling:
            pass

    def _diagnostics_in_steps(self) -> Iterator[None]:
        now = time.monotonic()
        ticks = max((signal.rows.end or 0 for signal in self.inputs), default=0) if self.lockstep else self.counts["ticks"]
        missed = self.counts["missed ticks"]
        before, ticks_before, missed_before = self._diagnosed
        self._diagnosed = (now, ticks, missed)
        wrong_clocks = self.source_clocks.look(self.longest_age, self.settings.ahead)
        for topic, seconds in wrong_clocks.items():
            self.warn(f"{topic}: clock", f"{topic}: its times are {describe(seconds)} this node's clock: {CLOCK_REMEDY}")
        sources = {signal.topic: self.count_publishers(signal.topic) for signal in self.inputs}
        health = NodeHealth(
            trouble=self.trouble(),
            wrong_clocks=list(wrong_clocks),
            stale=[signal.topic for signal in self.inputs if not self.lockstep and signal.age > self.settings.timeout],
            contested=[topic for topic, count in sources.items() if count > self.settings.most_sources],
            waits=self.waits(now),
            enabled=self.working,
            slow=self._slow(ticks - ticks_before, missed - missed_before, now - before) if before > self._ready_since else "",
            unheard=[signal.topic for signal in self.inputs if not self.lockstep and signal.needed and signal.rows.end is None],
        )
        for topic in health.contested:
            self.warn(f"{topic}: sources", f"{topic}: {sources[topic]} nodes publish this topic: was one started twice?")
        values: dict[str, Any] = {
            "schedule": self.settings.schedule,
            **({} if self.lockstep else {"offset to ROS time [s]": f"{self.offset_to_ros_time:.6f}"}),
            **self.source_clocks.entries(),
            "rate [Hz]": f"{(ticks - ticks_before) / (now - before):.1f}",
            **({} if self.lockstep else {"set rate [Hz]": f"{1.0 / self.tick_timer.interval:.1f}"}),
            "ticks": ticks,
            "jitter [us]": f"{self.tick_timer.jitter.take() * 1e6:.1f}",
            **health.entries,
            "handed over": ", ".join(sender.topic for sender in self.senders if sender.within) or "none",
            **{f"age of {signal.topic} [s]": f"{signal.age:.4f}" for signal in self.inputs},
        }
        stamp = self.get_clock().now()
        yield
        values |= self.tick_timer.intervals.entries("period")
        yield
        values |= {key: count for key, count in self.counts.items() if key != "ticks" and count} | self.status()
        yield
        message = self._diagnostics.message(health, values, stamp)
        yield
        self._diagnostics.publish(message)
        if self._ready_since < now:
            self._state_log.tell(health)

    def _slow(self, ticks: int, missed: int, seconds: float) -> str:
        """Rate that is not kept, "" when at most `MISSED_SHARE` of the ticks were missed."""
        if self.lockstep or missed <= MISSED_SHARE * (ticks + missed):
            return ""
        return f"{ticks / seconds:.0f} of {1.0 / self.tick_timer.interval:.0f} Hz: {missed} ticks missed"

    def _say_ready(self) -> None:
        pace = "lockstep" if self.lockstep else f"timer, {1.0 / self.tick_timer.interval:g} ticks/s"
        self._ready_since = time.monotonic()
        hears = ", ".join(self.resolve_topic_name(topic) for topic in self.received) or "nothing"
        says = ", ".join(sender.topic for sender in self.senders) or "nothing"
        self.get_logger().info(f"ready: {pace}; axes {', '.join(self.axes)}; hears {hears}; publishes {says}")
