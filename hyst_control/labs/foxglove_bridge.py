# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Live plots in Foxglove of a running loop's signals: `python -m hyst_control.labs.foxglove_bridge`, with ROS 2 and foxglove-sdk."""

from __future__ import annotations

import argparse
import sys
from typing import Any

from hyst_control.base.errors import InputError
from hyst_control.records.stream.signal_message import MESSAGE_TYPE, decode, parse_label

PORT = 8765  # where Foxglove looks by itself
NEW_TOPICS = 0.5  # s, between two looks for topics


class Bridge:
    """Every signal of the ROS graph as a JSON channel: `{"t": 1.25, "x": 3.0}`, at most `rate` rows a second of each."""

    def __init__(self, node: Any, context: Any, rate: float) -> None:
        self._node, self._context, self._least_step = node, context, 1.0 / rate
        self._subscriptions: dict[str, Any] = {}
        self._channels: dict[tuple[str, str], Any] = {}
        self._shown: dict[str, float] = {}  # s, sample time of the newest row shown, by topic
        node.create_timer(NEW_TOPICS, self.look)

    def look(self) -> None:
        """Subscribe to the signals that have appeared."""
        from rclpy.qos import QoSProfile, ReliabilityPolicy
        from std_msgs.msg import Float64MultiArray

        listener = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)  # type: ignore[no-untyped-call]  # holds no writer up
        for topic, types in self._node.get_topic_names_and_types():
            if MESSAGE_TYPE in types and topic not in self._subscriptions:
                self._subscriptions[topic] = self._node.create_subscription(
                    Float64MultiArray, topic, lambda buffer, topic=topic: self.show(topic, buffer), listener, raw=True
                )

    def show(self, topic: str, buffer: bytes) -> None:
        """Pass a message on; rows that follow a shown one within the least step are left out, and so is what is no signal."""
        try:
            label, rows = decode(buffer)
            axes, units = parse_label(label)
        except InputError:
            return
        channel = self._channel(topic, axes, units)
        for row in rows:
            time, before = float(row[0]), self._shown.get(topic, -1.0)
            if before <= time < before + self._least_step * (1.0 - 1e-9):
                continue
            self._shown[topic] = time
            channel.log(dict(zip(("t", *axes), row.tolist(), strict=True)))

    def _channel(self, topic: str, axes: tuple[str, ...], units: tuple[str, ...]) -> Any:
        """The channel of a topic, whose schema tells the units; another label makes another channel."""
        from foxglove import Channel

        key = topic, ",".join((*axes, *units))
        if key not in self._channels:
            columns = zip(("t", *axes), ("s", *units), strict=True)
            properties = {name: {"type": "number", "description": unit} for name, unit in columns}
            schema = {"type": "object", "title": key[1], "properties": properties}
            self._channels[key] = Channel(topic, schema=schema, message_encoding="json", context=self._context)
        return self._channels[key]


def main(words: list[str] | None = None) -> int:
    """Serve until interrupted; the exit status."""
    parser = argparse.ArgumentParser(prog="foxglove_bridge", description="Live plots in Foxglove of a running loop (docs/labs.md)")
    parser.add_argument("--port", type=int, default=PORT, help=f"port of the websocket (default {PORT}; 0: any free one)")
    parser.add_argument("--host", default="127.0.0.1", help="address to serve on (default 127.0.0.1: this machine alone)")
    parser.add_argument("--rate", type=float, default=100.0, help="most rows a second of each signal (default 100)")
    given = parser.parse_args(words)
    try:
        if not 0.0 < given.rate <= 1e6:
            raise InputError(f"--rate: must be above 0 and at most 1e6 Hz, got {given.rate:g}")
        serve(given.host, given.port, given.rate)
    except InputError as error:
        print(f"foxglove_bridge: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        pass
    return 0


def serve(host: str, port: int, rate: float) -> None:
    """Show the signals of the ROS graph to clients at an address."""
    try:
        import foxglove
    except ModuleNotFoundError:
        raise InputError("foxglove-sdk is not installed: pip install foxglove-sdk") from None
    try:
        import rclpy
        from rclpy.executors import ExternalShutdownException
    except ModuleNotFoundError:
        raise InputError("ROS 2 is not there: the bridge shows signals of its nodes") from None
    context = foxglove.Context()
    try:
        server = foxglove.start_server(name="hyst_control", host=host, port=port, context=context)
    except (OSError, OverflowError, RuntimeError, ValueError) as error:
        raise InputError(f"--host {host} --port {port}: {error}: give an address of this machine and a free port") from None
    print(f"Foxglove: open a connection to ws://{host}:{server.port}", flush=True)
    rclpy.init()
    node: Any = rclpy.create_node("foxglove_bridge")
    bridge = Bridge(node, context, rate)
    bridge.look()
    try:
        rclpy.spin(node)
    except ExternalShutdownException:
        pass  # interrupted
    finally:
        server.stop()
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    raise SystemExit(main())
