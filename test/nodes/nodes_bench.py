"""A bench for the tests of nodes: nodes under test on one executor, and a node that talks to them and hears them."""

from __future__ import annotations

import time

import numpy as np
import pytest
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.experimental import EventsExecutor
from rclpy.parameter import Parameter
from rclpy.task import Future

from hyst_control.nodes.execution.run import close, spin
from hyst_control.nodes.signal_node.message_io import CallbackSubscription, Sender


class Bench:
    """Nodes under test on one executor, and a node that talks to them."""

    def __init__(self, context) -> None:
        self.context, self.executor = context, EventsExecutor(context=context)
        self.probe = rclpy.create_node("probe", context=context)
        self.executor.add_node(self.probe)
        self.nodes = []
        self.heard: dict[str, list[np.ndarray]] = {}
        self.said: dict[str, dict[str, str]] = {}

    def add(self, make, /, **settings):
        overrides = [Parameter(name, value=value) for name, value in settings.items()]
        node = make(context=self.context, parameter_overrides=overrides)
        self.executor.add_node(node)
        self.nodes.append(node)
        return node

    def listen(self, *topics):
        for topic in topics:
            rows = self.heard.setdefault(topic, [])
            CallbackSubscription(self.probe, topic, lambda label, block, rows=rows: rows.append(block.copy()), pytest.fail)

    def listen_to_diagnostics(self):
        """From now on `said` holds the newest entries by node, the status' message among them."""

        def note(message):
            for status in message.status:
                self.said[status.name] = {
                    "level": status.level,
                    "message": status.message,
                    **{each.key: each.value for each in status.values},
                }

        self.probe.create_subscription(DiagnosticArray, "/diagnostics", note, 10)

    def says(self, node, text):
        """Whether the node's newest diagnostics have this message, or this entry other than none."""
        entries = self.said.get(f"/{node}: loop", {})
        return text in entries["message"] or entries.get(text, "none") != "none" if entries else False

    def sender(self, topic, label):
        sender = Sender(self.probe, topic, label)
        self.until(lambda: sender.publisher.get_subscription_count() > 0)
        return sender

    def call(self, kind, service, request):
        """The answer of a service."""
        client = self.probe.create_client(kind, service)
        self.until(client.service_is_ready)
        called = client.call_async(request)
        self.until(called.done)
        return called.result()

    def until(self, condition, timeout=20.0):
        end = time.monotonic() + timeout
        while not condition():
            assert time.monotonic() < end, "condition not met in time"
            spin(self.executor, Future(), 0.005)

    def rows(self, topic):
        heard = self.heard[topic]
        if len(heard) > 1:
            heard[:] = [np.concatenate(heard)]
        return heard[0] if heard else np.zeros((0, 2))

    def close(self):
        """Close and destroy the nodes as an executable does at its end."""
        close(self.nodes, self.probe.destroy_node)
        self.executor.shutdown()
