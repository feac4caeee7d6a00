"""A plant node of many axes under the timer, with a sender of commands and a receiver of measurements: processor time of a tick.

Run as a process of its own by `hyst bench --only many_axes`.
"""

from __future__ import annotations

import json
import sys
import time
from dataclasses import replace
from typing import Any

import numpy as np
import rclpy
from rclpy.parameter import Parameter

from hyst_control.base.config_files import config_path
from hyst_control.model_file import Simulator, load_model
from hyst_control.nodes.signal_node.message_io import PolledSubscription, Sender
from hyst_plant_sim.node import PlantNode

WARM_UP = 200
"""Ticks before those that count."""


def seconds_of_a_tick(axes: int, ticks: int, rate: float, domain: int) -> tuple[float, float, float]:
    """Measure processor time."""
    model = load_model(config_path("models/pea_hampi.yaml"))
    names = tuple(f"a{index}" for index in range(axes))
    plant = Simulator(replace(model, axes=names), 1.0 / rate)
    commands = 25.0 + 5.0 * np.random.default_rng(0).standard_normal((64, axes))
    context = rclpy.Context()
    context.init(domain_id=domain)
    given: dict[str, Any] = {
        "axes": list(names),
        "rate_hz": rate,
        "schedule": "timer",
        "unit": plant.units["measurement"],
        "safe_command": [25.0],
    }
    overrides = [Parameter(name, value=value) for name, value in given.items()]
    node = PlantNode(plant=plant, context=context, parameter_overrides=overrides)
    beside = rclpy.create_node("beside", context=context)
    try:
        sender = Sender(beside, "command", node.command.label)
        receiver = PolledSubscription(beside, "measurement")
        while not sender.publisher.get_subscription_count() or not node.measurement.publisher.get_subscription_count():
            time.sleep(0.01)
        spent, received, block = 0.0, 0, np.empty((1, 1 + len(names)))
        before = time.process_time()
        first = int(time.monotonic() * rate) + 1
        for count in range(WARM_UP + ticks):
            tick = first + count
            while (left := tick / rate - time.monotonic()) > 0.0:
                time.sleep(left)
            if count == WARM_UP:
                before = time.process_time()
            block[0, 0], block[0, 1:] = tick / rate, commands[count % len(commands)]
            sender.send(block)
            begin = time.thread_time()
            node.timer.tick(tick)
            if count >= WARM_UP:
                spent += time.thread_time() - begin
            received += len(receiver.take(_refused))
        whole = time.process_time() - before
        if received < 0.5 * ticks or not node.command.rows.end:
            raise RuntimeError(f"only {received} of {ticks} measurements arrived")
        begin = time.thread_time()
        for count in range(ticks // 4):
            plant.step(commands[count % len(commands)][None])
        chain = 4.0 * (time.thread_time() - begin) / ticks
    finally:
        node.destroy_node()
        beside.destroy_node()
        context.try_shutdown()
    return spent / ticks, whole / ticks, chain


def _refused(reason: str) -> None:
    raise RuntimeError(f"a measurement cannot be read: {reason}")


if __name__ == "__main__":
    print(json.dumps(seconds_of_a_tick(int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3]), int(sys.argv[4]))))
