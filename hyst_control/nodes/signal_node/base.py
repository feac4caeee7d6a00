# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Base class of the nodes that turn signals into signals: rows in and out by tick, parameters, services, diagnostics.

One code path serves two schedules, `Lockstep` and `Timer`, which say when a node is called and what becomes of received rows.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from types import SimpleNamespace
from typing import Any

from rclpy.subscription import Subscription
from std_srvs.srv import SetBool

from hyst_control.base.errors import InputError
from hyst_control.nodes.signal_node.common_parameters import COMMON, LOCKSTEP
from hyst_control.nodes.signal_node.lockstep import Lockstep
from hyst_control.nodes.signal_node.message_io import CallbackSubscription, PolledSubscription, Sender
from hyst_control.nodes.signal_node.node_diagnostics import NodeDiagnostics
from hyst_control.nodes.signal_node.parameters import Setting, declare
from hyst_control.nodes.signal_node.signal_ports import Input, Output, ScheduledNode
from hyst_control.nodes.signal_node.timer import Timer
from hyst_control.processes.realtime_scheduling import set_scheduler
from hyst_control.records.stream.signal_message import label_for
from hyst_control.records.stream.signal_rows import Missing, SignalRows, Wait


class SignalNode(ScheduledNode):
    """Node that turns signals into signals. Subclasses implement `advance` (lockstep) and `tick` (timer)."""

    COMMON_SETTINGS = COMMON
    REMEDIES: Mapping[str, str] = {}  # Remedies for a topic that does not come, by topic

    def __init__(self, name: str, **options: Any) -> None:
        self.polled: list[PolledSubscription] = []
        self.receptions: list[CallbackSubscription] = []
        self.senders: list[Sender] = []
        super().__init__(name, **options)
        elsewhere = self.elsewhere - self.named.get(self.get_name(), set())
        self.settings = declare(self, (*COMMON, *self.SETTINGS), self.changed, self.check_change, self.further_settings, elsewhere)
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
        self.counts: Counter[str] = Counter()
        self.schedule: Lockstep | Timer = (
            Lockstep(self)
            if self.lockstep
            else Timer(self, self.period, self.settings.block, bool(self.get_parameter("use_sim_time").value))
        )
        self._warned: dict[str, float] = {}  # s, when it was, by key
        self.diagnostics = NodeDiagnostics(self)
        self.service("reset", self._reset)
        self.service("stop", self._stop)
        self.create_service(SetBool, "~/enable", self._on_enable)

    @property
    def timer(self) -> Timer:
        """The schedule, where that is the timer."""
        assert isinstance(self.schedule, Timer)
        return self.schedule

    def changed(self, name: str, value: Any) -> None:
        """Take over the new value of a live parameter."""

    def further_settings(self, given: SimpleNamespace) -> Iterable[Setting]:
        """Parameters of the node besides `SETTINGS`, which depend on those that were given."""
        return ()

    def check_change(self, values: Mapping[str, Any]) -> None:
        """Refuse values of live parameters that cannot be taken over, by an `InputError` with the reason."""

    def check_fits(self, name: str, axes: Sequence[str], units: Mapping[str, str]) -> None:
        """Refuse a model whose axes and units are not the node's."""
        if tuple(axes) != self.axes or units != {"command": "V", "measurement": self.unit}:
            found = f"[{', '.join(axes)}] in {units['measurement']} of {units['command']}"
            raise InputError(f"{name} has axes {found}: set the parameters axes and unit to them")

    @property
    def working(self) -> bool:
        """False once the node has been asked to stop."""
        return self.enabled

    def trouble(self) -> str:
        """Fault that keeps the node from its work, for the diagnostics; "" when there is none."""
        return ""

    def waits(self, now: float) -> list[Wait]:
        """Signals that the node is waiting for at a time (s) of the monotonic clock, in lockstep."""
        return self.schedule.waits(now)

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
            (lambda end: self.schedule.is_due((end - 1) * self.period)) if sparse else (lambda end: False),
        )
        return self.received[topic]

    def input(self, topic: str, unit: str, every_row: bool = True, replace: bool = False) -> Input:
        """Subscribe to a signal."""
        # every_row: refuse rows that skip earlier ones, in lockstep; False also means that under the timer the node works without
        # the signal
        rows = self.signal_rows(topic, **self.schedule.row_rules(every_row, replace))
        source = Input(self, topic, label_for(self.axes, unit), rows, every_row)
        if self.lockstep:
            self.receptions.append(CallbackSubscription(self, topic, source.receive, source.refused, self.settings.message_objects))
        else:
            source.intake = self.intake(topic)
        self.inputs.append(source)
        return source

    def output(self, topic: str, unit: str) -> Output:
        """Create the publisher of a signal."""
        label, objects = label_for(self.axes, unit), self.settings.message_objects
        self.senders.append(Sender(self, topic, label, objects, self.schedule.look_interval))
        return Output(self.senders[-1], len(self.axes) + 1, self.period, self.settings.block)

    def _reset(self) -> str:
        for signal in self.inputs:
            signal.forget()
        self.enabled = True
        if not self.lockstep:
            self.timer.overrun_streak = 0
        self.reset()
        return "reset"

    def _stop(self) -> str:
        self.enabled = False
        return "stopped: call ~/enable or ~/reset to continue"

    def _on_enable(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        self.enabled = request.data
        self.schedule.resume()
        response.success, response.message = True, "enabled" if request.data else "disabled"
        return response
