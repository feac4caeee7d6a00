# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Dashboard node: what a live page shows of the loop, and the requests of its buttons; `hyst dashboard` runs it beside the web server."""

from __future__ import annotations

import _thread
import json
import math
import os
import queue
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.context import Context
from rclpy.experimental import EventsExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from std_srvs.srv import SetBool, Trigger

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.dashboard.live_state import LiveState, NodeState
from hyst_control.nodes.execution import interrupts
from hyst_control.nodes.execution.command_line import in_namespace
from hyst_control.nodes.execution.ending_node import EndingNode
from hyst_control.nodes.execution.run import close, spin
from hyst_control.nodes.live_view import LiveView
from hyst_control.nodes.signal_node.message_io import CallbackSubscription
from hyst_control.processes import environment
from hyst_control.processes.node_processes import Processes

POLL_INTERVAL = 0.05  # s, between two looks at what the page has asked
ANSWER_TIMEOUT = 3.0  # s that a node has to answer a request
DISCOVERY = 1.5  # s for which a loop must have run without a live view before one is run here
DRIVING = ("command", "applied")
"""Topics whose publishers drive the actuator, in the order in which they are asked: the feedback, then plant or stage."""
ASKED = {
    "enable": (SetBool, SetBool.Request(data=True)),
    "stop": (Trigger, Trigger.Request()),
    "reset": (Trigger, Trigger.Request()),
}
"""Type and request of the services that the buttons call."""


@dataclass(frozen=True)
class LoopSettings:
    """Settings of the loop that a page shows."""

    rate_hz: float = 1000.0  # Sample rate of its signals, Hz
    schedule: str = "timer"  # "timer" or "lockstep"
    axes: tuple[str, ...] = ("x",)  # Names of its axes
    unit: str = "um"  # Unit of the measurement, "um" or "mrad"
    namespace: str = ""  # Namespace of its topics; "" for none

    @property
    def parameters(self) -> dict[str, Any]:
        """Parameters that every node of the loop has."""
        return {name: value for name, value in asdict(self).items() if name != "namespace"} | {"axes": list(self.axes)}

    @property
    def arguments(self) -> list[str]:
        """ROS arguments that give them to nodes."""
        values = [word for name, value in self.parameters.items() for word in ("-p", f"{name}:={json.dumps(value)}")]
        return ["hyst", "--ros-args", *in_namespace(self.namespace), *values]


class DashboardNode(EndingNode):
    """Node that listens to `live`, `live_turn`, `gap` and `/diagnostics`, and calls services of the nodes that drive the actuator.

    Everything is done on the thread that spins it; `ask` and `leave` may be called from another one.
    """

    def __init__(self, state: LiveState, name: str = "dashboard", **options: Any) -> None:
        super().__init__(name, **options)
        self._state = state
        self._asked: queue.SimpleQueue[str] = queue.SimpleQueue()
        self._pending: list[tuple[float, str, Future]] = []  # deadline in s, request in words, its answer
        self.ended = Future()
        self.unserved: Callable[[], None] = lambda: None  # Called once, when the loop runs and has no live view
        self._unserved_since = math.inf
        self._served = False
        for topic, take in (("live", state.signals.add), ("live_turn", state.set_turn), ("gap", state.gap.add)):
            CallbackSubscription(self, topic, partial(_receive, take), self._state.answers.append)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 100)
        self.every(POLL_INTERVAL, self._poll)

    def ask(self, what: str) -> None:
        """Ask the nodes that drive the actuator to do something."""
        self._asked.put(what)

    def say(self, words: str) -> None:
        """Show a line on the page."""
        self._state.answers.append(words)

    def forget(self, name: str) -> None:
        """Show a node of this namespace no more, as it was ended on purpose."""
        self._state.forget_node(f"{self.get_namespace()}/{name}".lstrip("/"))

    def leave(self) -> None:
        """End the spinning of the node."""
        self._asked.put("")

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            full_name, _, what = status.name.rpartition(":")
            if what.strip() == "loop" and full_name.startswith(self.get_namespace()):
                values = {entry.key: entry.value for entry in status.values}
                warns = status.level != DiagnosticStatus.OK
                self._state.set_node(NodeState(full_name.lstrip("/"), warns, status.message, values, time.monotonic()))

    def _poll(self) -> None:
        while not self._asked.empty():
            what = self._asked.get()
            if what:
                self._ask(what)
            elif not self.ended.done():
                self.ended.set_result(None)
        now = time.monotonic()
        self._state.look()
        self._look_for_a_view(now)
        for deadline, words, answer in list(self._pending):
            if answer.done() or now > deadline:
                self._pending.remove((deadline, words, answer))
                self._state.answers.append(f"{words}: {_said(answer)}")

    def _look_for_a_view(self, now: float) -> None:
        if self._served:
            return
        if self.count_publishers("live"):
            self._served = True
        elif self.count_publishers("measurement"):
            self._unserved_since = min(self._unserved_since, now)
            if now - self._unserved_since > DISCOVERY:
                self._served = True
                self.unserved()

    def _ask(self, what: str) -> None:
        kind, request = ASKED[what]
        nodes = self.driving_nodes()
        if not nodes:
            self._state.answers.append(f"{what}: nobody was asked, because no node publishes command")
        for node in nodes:
            client = self.create_client(kind, f"{node}/{what}")
            words = f"{time.strftime('%H:%M:%S')} {what} {node.lstrip('/')}"
            answer = client.call_async(request)
            answer.add_done_callback(lambda _, client=client: self.once(partial(self.destroy_client, client)))
            self._pending.append((time.monotonic() + ANSWER_TIMEOUT, words, answer))

    def driving_nodes(self) -> list[str]:
        """Full names of the nodes that drive the actuator, the feedback first."""
        found = [
            f"{info.node_namespace.rstrip('/')}/{info.node_name}"
            for topic in DRIVING
            for info in self.get_publishers_info_by_topic(self.resolve_topic_name(topic))
        ]
        return list(dict.fromkeys(found))


class LoopActions:
    """Requests of a page: services by the node, recordings as processes."""

    def __init__(self, node: DashboardNode, processes: Processes, loop: LoopSettings, folder: Path) -> None:
        self._node, self._processes, self._loop, self._folder = node, processes, loop, folder
        self._bag = ""
        self._count = 0

    def ask(self, what: str) -> None:
        """Ask the nodes that drive the actuator."""
        self._node.ask(what)

    @property
    def recording(self) -> str:
        """Sentence about the recording that runs, "" when there is none."""
        recorder = self._processes.running.get(self._name)
        if recorder is None or not self._bag:
            return ""
        begun = Path(self._bag).is_dir()
        if recorder.poll() is None:
            return f"{'Recording' if begun else 'Starting to record'} to {self._bag}."
        self._node.forget(self._name)
        if not begun and recorder.returncode < 0:
            self._node.say("nothing was recorded: it was ended before it had begun")
        else:
            lines = self._processes.log(self._name).read_text(encoding="utf-8", errors="replace").strip().splitlines()
            failed = f"recording failed: {lines[-1] if lines else 'no output'}"
            self._node.say(failed if recorder.returncode else f"recorded: {self._bag}")
        self._bag = ""
        return ""

    def record(self) -> None:
        """Begin a recording, or end the one that runs."""
        if self.recording:
            self._processes.running[self._name].send_signal(signal.SIGINT)
            return
        self._count += 1
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            self._node.say(f"record: {self._folder}: {error.strerror}: start with --folder and one that can be written")
            return
        self._bag = str(self._folder / f"{time.strftime('%Y%m%dT%H%M%S')}-{self._count}")
        self._processes.start("recorder", {**self._loop.parameters, "output": self._bag, "merge": 50}, self._name)

    @property
    def _name(self) -> str:
        return f"dashboard_recorder_{self._count}"


def _receive(take: Callable[[tuple[str, ...], Array], None], label: str, block: Array) -> None:
    take(tuple(label.split(",")), block)


def _said(answer: Future) -> str:
    """Answer of a service in words."""
    if not answer.done():
        return f"no answer within {ANSWER_TIMEOUT:g} s"
    if (error := answer.exception()) is not None:
        return str(error)
    result = answer.result()
    return str(result.message) if result.success else f"refused: {result.message}"


@contextmanager
def live_loop(loop: LoopSettings, state: LiveState, folder: Path, context: Context) -> Iterator[LoopActions]:
    """Listen to a loop on a thread within the context, through the live view that runs beside it or one on this thread."""
    domain = int(os.environ.get("ROS_DOMAIN_ID") or 0)
    namespace = f"/{loop.namespace.strip('/')}" if loop.namespace.strip("/") else ""
    with ExitStack() as stack:
        logs = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        processes = stack.enter_context(Processes(logs, domain, namespace))
        node = DashboardNode(state, context=context)
        nodes: list[EndingNode] = [node]
        stack.callback(close, nodes)
        executor = EventsExecutor(context=context)
        executor.add_node(node)

        def view() -> None:
            nodes.append(LiveView("dashboard_view", context=context))
            executor.add_node(nodes[-1])

        failures: list[BaseException] = []

        def listen() -> None:
            try:
                spin(executor, node.ended)
            except BaseException as error:
                failures.append(error)
                _thread.interrupt_main()  # a page that shows nothing new must not stay

        node.unserved = view
        thread = threading.Thread(target=listen, name="dashboard", daemon=True)
        thread.start()
        try:
            yield LoopActions(node, processes, loop, folder)
        finally:
            node.leave()
            thread.join(timeout=5.0)
            executor.shutdown()
            if failures:
                raise failures[0]


def serve(loop: LoopSettings, port: int, folder: Path, window: float, opened: Callable[[str], None]) -> int:
    """Show a loop on a page until Ctrl-C."""
    try:
        from hyst_control.dashboard.page import LivePage
        from hyst_control.dashboard.server import LiveServer
    except ModuleNotFoundError as error:
        raise InputError(f"{error.name} is not installed: pip install 'hyst_control[dashboard]'") from None
    if exposed := environment.exposure():
        print(exposed, file=sys.stderr)
    environment.prepare()
    # A shell starts a job in the background with interrupts ignored: this one could neither be ended nor end itself.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    interrupts.end_with_parent()
    context = Context()
    rclpy.init(args=loop.arguments, context=context, signal_handler_options=SignalHandlerOptions.NO)
    state = LiveState(window)
    try:
        with live_loop(loop, state, folder, context) as actions:
            title = f"hyst dashboard: {loop.namespace.strip('/') or 'loop'}, {loop.rate_hz:g} Hz"
            server = LiveServer(LivePage(state, actions, title), port)
            opened(server.url)
            server.run()
    except KeyboardInterrupt:
        pass
    finally:
        rclpy.try_shutdown(context=context)
    return 0
