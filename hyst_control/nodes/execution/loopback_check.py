# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Messages there and back between two participants on this computer: what the middleware needs to work at all.

Run as a process: prints one sentence and ends with 0, or with 1 where no message arrives in time.
"""

from __future__ import annotations

import sys
import time

import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64MultiArray

ROUNDS = 100
PATIENCE = 20.0  # Seconds that the participants have to find each other and exchange their messages


def main() -> int:
    """Send a message there and back, `ROUNDS` times."""
    contexts = [Context(), Context()]
    for context in contexts:
        rclpy.init(context=context)
    here, there = (Node(f"loopback_{index}", context=context) for index, context in enumerate(contexts))
    executors = [SingleThreadedExecutor(context=context) for context in contexts]
    for node, executor in zip((here, there), executors, strict=True):
        executor.add_node(node)
    profile = QoSProfile(depth=10)
    returned: list[float] = []
    echo = there.create_publisher(Float64MultiArray, "back", profile)
    there.create_subscription(Float64MultiArray, "out", echo.publish, profile)
    sender = here.create_publisher(Float64MultiArray, "out", profile)

    def take(message: Float64MultiArray) -> None:
        returned.append(message.data[0])

    here.create_subscription(Float64MultiArray, "back", take, profile)
    durations: list[float] = []
    begin = time.monotonic()

    def turn() -> bool:
        """Let both take what has arrived; whether there is time left."""
        for executor in executors:
            executor.spin_once(timeout_sec=1e-3)
        return time.monotonic() < begin + PATIENCE

    while not (sender.get_subscription_count() and echo.get_subscription_count()) and turn():
        pass
    found = time.monotonic() - begin
    while len(durations) < ROUNDS:
        sent = time.monotonic()
        sender.publish(Float64MultiArray(data=[float(len(durations))]))
        while len(returned) <= len(durations):
            if not turn():
                print(f"{len(durations)} of {ROUNDS} messages came back within {PATIENCE:g} s", file=sys.stderr)
                return 1
        durations.append(time.monotonic() - sent)
    median = sorted(durations)[ROUNDS // 2]
    print(f"two participants met after {found:.2f} s, a message there and back takes {1e3 * median:.2f} ms")
    return 0


if __name__ == "__main__":
    sys.exit(main())
