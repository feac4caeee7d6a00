# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Baseline of `hyst bench`: the same loop in plain rclpy (SingleThreadedExecutor, message objects, one callback per message).

Four small nodes with the computations of the package's nodes and nothing else: no checks of messages, no repetition, no recorder.
"""

from __future__ import annotations

import array
import json
import math
import signal
import sys
import time
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.signals import SignalHandlerOptions
from std_msgs.msg import Float64MultiArray

from hyst_control.base.arrays import Array
from hyst_control.control.feedback.pi import PI
from hyst_control.control.feedforward.compensator import build_compensator
from hyst_control.model_file import Simulator, load_model
from hyst_control.nodes.signal_node.duration_histogram import Durations
from hyst_control.processes import environment

LIMITS = (0.0, 100.0)  # V
MAX_WAITING = 5000  # rows of a signal


class PlainNode(Node):
    """Base of the four nodes: period, rows in, rows out."""

    def __init__(self, name: str, settings: Mapping[str, Any]) -> None:
        super().__init__(name)
        self.period = 1.0 / settings["rate_hz"]
        self.timed = settings["schedule"] == "timer"
        self.model = load_model(settings["model"])
        self.axes = len(self.model.axes)
        self.settings = settings
        self.create_timer(0.5, lambda: None)  # wakes the executor, which handles no signal while it waits
        if self.timed:
            self.create_timer(self.period, self.tick)

    def tick(self) -> None:
        """Produce one sample, under the timer."""

    def subscribe(self, topic: str, callback: Callable[[int, Array], None]) -> None:
        """Subscribe to a topic."""

        def on_message(message: Float64MultiArray) -> None:
            row = np.array(message.data)
            callback(round(row[0] / self.period), row[1:].reshape(1, -1))

        self.create_subscription(Float64MultiArray, topic, on_message, 5000)

    def publish_row(self, publisher: Publisher, tick: int, values: Annotated[Array, "1 A"]) -> None:
        """Publish one row."""
        publisher.publish(Float64MultiArray(data=array.array("d", [tick * self.period, *values.ravel().tolist()])))


class PlainReference(PlainNode):
    """Node that publishes a sine as the reference, one row per measurement."""

    def __init__(self, settings: Mapping[str, Any]) -> None:
        super().__init__("plain_reference", settings)
        self.count = 0
        self.publisher = self.create_publisher(Float64MultiArray, "reference", 5000)
        if not self.timed:
            self.subscribe("measurement", lambda tick, values: self.send(tick))

    def send(self, tick: int) -> None:
        """Publish the reference of a tick."""
        turn = 2 * math.pi * self.settings["frequency"] * tick * self.period
        value = self.settings["offset"] - self.settings["amplitude"] * math.cos(turn)
        self.publish_row(self.publisher, tick, np.full(self.axes, value))

    def tick(self) -> None:
        self.send(self.count)
        self.count += 1


class PlainFeedforward(PlainNode):
    """Node with the inverse of the model."""

    def __init__(self, settings: Mapping[str, Any]) -> None:
        super().__init__("plain_feedforward", settings)
        self.compensator = build_compensator(self.model, "mhl", sample_time=self.period, limits=LIMITS)
        self.compensator.settle(np.zeros(self.axes))
        self.publisher = self.create_publisher(Float64MultiArray, "feedforward", 5000)
        self.subscribe("reference", lambda tick, values: self.publish_row(self.publisher, tick, self.compensator.process(values)))


class PlainFeedback(PlainNode):
    """Node that adds PI feedback to the feedforward."""

    def __init__(self, settings: Mapping[str, Any]) -> None:
        super().__init__("plain_feedback", settings)
        self.controller = PI(settings["kp"], settings["ki"], self.period, *LIMITS).start(self.axes)
        self.controller.reset(np.zeros(self.axes))
        self.rows: dict[str, dict[int, Array]] = {topic: {} for topic in ("reference", "feedforward", "measurement")}
        self.newest: dict[str, tuple[int, Array]] = {}
        self.count = 0
        self.command = self.create_publisher(Float64MultiArray, "command", 5000)
        self.feedback = self.create_publisher(Float64MultiArray, "feedback", 5000)
        for topic in self.rows:
            self.subscribe(topic, partial(self.receive, topic))

    def receive(self, topic: str, tick: int, values: Annotated[Array, "1 A"]) -> None:
        """Keep a row, and compute the command once all rows of its tick are there."""
        self.newest[topic] = tick, values
        if not self.timed:
            self.rows[topic][tick] = values
            if len(self.rows[topic]) > MAX_WAITING:
                del self.rows[topic][next(iter(self.rows[topic]))]
            if all(tick in rows for rows in self.rows.values()):
                self.control(tick, {name: rows.pop(tick) for name, rows in self.rows.items()})

    def control(self, tick: int, rows: Mapping[str, Array]) -> None:
        """Compute and publish feedback and command of a tick."""
        command, feedback = self.controller.step(rows["reference"], rows["measurement"], rows["feedforward"])
        self.publish_row(self.feedback, tick, feedback)
        self.publish_row(self.command, tick, command)

    def tick(self) -> None:
        if len(self.newest) == len(self.rows):
            self.control(self.newest["measurement"][0], {topic: values for topic, (_, values) in self.newest.items()})


class PlainPlant(PlainNode):
    """Node that runs the model as the plant and publishes measured rates and latencies as diagnostics."""

    def __init__(self, settings: Mapping[str, Any]) -> None:
        super().__init__("plain_plant", settings)
        self.plant = Simulator(self.model, self.period)
        self.measured = self.plant.reset(np.zeros(self.axes))[None]
        self.count, self.rounds = 0, 0
        self.held = np.zeros((1, self.axes))
        self.sent: dict[int, float] = {}
        self.latency, self.intervals, self.last = Durations(), Durations(), math.nan
        self.publisher = self.create_publisher(Float64MultiArray, "measurement", 5000)
        self.subscribe("command", self.apply)
        self.diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_timer(1.0, self.publish_diagnostics)
        if not self.timed:
            self.create_timer(0.2, lambda: self.publish_row(self.publisher, self.count, self.measured) if not self.rounds else None)

    def apply(self, tick: int, values: Annotated[Array, "1 A"]) -> None:
        """Apply a command, in lockstep at once, under the timer at the next tick."""
        self.rounds += 1
        if self.timed:
            self.held = values
            if tick in self.sent:
                self.latency.add(time.monotonic() - self.sent.pop(tick))
        elif tick == self.count:
            self.send(values)

    def send(self, command: Annotated[Array, "1 A"]) -> None:
        """Run the plant over one command and publish the measurement that follows."""
        self.measured = self.plant.step(command)
        self.count += 1
        if self.timed:
            self.sent[self.count] = time.monotonic()
            self.sent.pop(self.count - 1000, None)
        self.publish_row(self.publisher, self.count, self.measured)

    def tick(self) -> None:
        now = time.monotonic()
        if not math.isnan(self.last):
            self.intervals.add(now - self.last)
        self.last = now
        self.send(self.held)

    def publish_diagnostics(self) -> None:
        """Publish the diagnostics."""
        values: dict[str, Any] = {"ticks": self.count if self.timed else self.rounds, "commands": self.rounds}
        values |= {**self.latency.entries("loop latency"), **self.intervals.entries("period")}
        entries = [KeyValue(key=key, value=str(value)) for key, value in values.items()]
        message = DiagnosticArray(status=[DiagnosticStatus(name="plain_plant: loop", values=entries)])
        message.header.stamp = self.get_clock().now().to_msg()
        self.diagnostics.publish(message)


NODES = {"reference": PlainReference, "feedforward": PlainFeedforward, "feedback": PlainFeedback, "plant": PlainPlant}


def main() -> None:
    """Run the named nodes, or all, on one executor until interrupted."""
    *names, path = sys.argv[1:]
    settings = json.loads(Path(path).read_text(encoding="utf-8"))
    environment.prepare()
    interrupts: list[int] = []
    # An exception within a call of rclpy would break that call.
    signal.signal(signal.SIGINT, lambda number, frame: interrupts.append(number))
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)  # else a Ctrl-C would destroy the context during a callback
    executor = SingleThreadedExecutor()
    for name in names or NODES:
        executor.add_node(NODES[name](settings))
    while not interrupts:
        executor.spin_once()
    rclpy.try_shutdown()


if __name__ == "__main__":
    main()
