"""The plant node with the 5,000 axes of a deformable mirror at 1 kHz: processor time of a tick, its messages through the middleware."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from hyst_control.config_files import config_path
from hyst_control.model_file import Simulator, load_model
from hyst_control.processes.ros_domain import own_domain
from hyst_control.reporting.tables import Table

AXES, RATE, TICKS = 5000, 1000.0, 2000
WARM_UP = 200
"""Ticks before those that count."""


def run(table: Table, axes: int = AXES, ticks: int = TICKS) -> None:
    """Measure the plant node under the timer, with a sender of commands and a receiver of measurements outside of it.

    Parameters
    ----------
    table
        Table to add to.
    axes
        Axes of the plant.
    ticks
        Ticks that count.
    """
    model = load_model(config_path("models/pea_hampi.yaml"))
    names = tuple(f"a{index}" for index in range(axes))
    plant = Simulator(replace(model, axes=names), 1.0 / RATE)
    commands = 25.0 + 5.0 * np.random.default_rng(0).standard_normal((64, axes))
    with own_domain() as domain:
        node_time, whole, chain = _ticks(plant, names, commands, ticks, domain)
    case = f"{axes} axes, model pea_hampi, {RATE / 1e3:g} kHz"
    table.add("many axes", case, "plant's chain", "processor_time", "ms/tick", 1e3 * chain, n=ticks)
    table.add("many axes", case, "plant node", "processor_time", "ms/tick", 1e3 * node_time, n=ticks)
    table.add("many axes", case, "node, sender, receiver, middleware", "processor_time", "ms/tick", 1e3 * whole, n=ticks)
    table.add("many axes", case, "plant node", "load", "% of one core", 100.0 * node_time * RATE, n=ticks)


def _ticks(plant: Simulator, names: tuple[str, ...], commands: np.ndarray, ticks: int, domain: int) -> tuple[float, float, float]:
    """Processor time (s) of a tick: of the node's thread, of the whole process, and of the chain alone."""
    import rclpy
    from rclpy.parameter import Parameter

    from hyst_control.nodes.message_io import PolledSubscription, Sender
    from hyst_plant_sim.node import PlantNode

    context = rclpy.Context()
    context.init(domain_id=domain)
    given = {"axes": list(names), "rate_hz": RATE, "schedule": "timer", "unit": plant.units["measurement"], "safe_command": [25.0]}
    overrides = [Parameter(name, value=value) for name, value in given.items()]  # type: ignore[no-untyped-call]
    node = PlantNode(plant=plant, context=context, parameter_overrides=overrides)
    beside = rclpy.create_node("beside", context=context)
    try:
        sender = Sender(beside, "command", node.command.label)
        receiver = PolledSubscription(beside, "measurement")
        while not sender.publisher.get_subscription_count() or not node.measurement.publisher.get_subscription_count():
            time.sleep(0.01)
        spent, received, block = 0.0, 0, np.empty((1, 1 + len(names)))
        before = time.process_time()
        first = int(time.monotonic() * RATE) + 1
        for count in range(WARM_UP + ticks):
            tick = first + count
            while (left := tick / RATE - time.monotonic()) > 0.0:
                time.sleep(left)
            if count == WARM_UP:
                before = time.process_time()
            block[0, 0], block[0, 1:] = tick / RATE, commands[count % len(commands)]
            sender.send(block)
            begin = time.thread_time()
            node.take_tick(tick)
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
        node.destroy_node()  # type: ignore[no-untyped-call]
        beside.destroy_node()  # type: ignore[no-untyped-call]
        context.try_shutdown()
    return spent / ticks, whole / ticks, chain


def _refused(reason: str) -> None:
    raise RuntimeError(f"a measurement cannot be read: {reason}")
