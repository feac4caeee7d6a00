# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Base class of nodes that can end by themselves: exit status, services, and timers of the steady clock."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Set
from typing import Any

from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.task import Future
from rclpy.timer import Timer
from std_srvs.srv import Trigger

from hyst_control.base.errors import InputError
from hyst_control.nodes.signal_node.parameters import Setting


class EndingNode(Node):
    """Node that can end by itself with an exit status and offers services of its own."""

    SETTINGS: tuple[Setting, ...] = ()
    COMMON_SETTINGS: tuple[Setting, ...] = ()  # Parameters that it shares with other kinds of nodes
    FURTHER = ""  # Sentence about parameters that depend on others
    elsewhere: frozenset[str] = frozenset()
    """Parameters of the other nodes in the process: an argument without a node's name reaches all of them."""
    named: Mapping[str, Set[str]] = {}  # Parameters that belong to a node of the process alone, by its name
    ends = False  # True when the node ends by itself

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        self.finished = Future()
        # not `_clock`: that is the node's own clock, which may be simulated
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)

    def wind_down(self) -> None:
        """Begin to leave the actuator at its safe value, after an interrupt; the node is spun until `wound_down`."""

    @property
    def wound_down(self) -> bool:
        """True when nothing keeps the node from ending."""
        return True

    def close(self) -> None:
        """Release the node's files and processes; called however the node ends."""

    def every(self, seconds: float, callback: Callable[[], None]) -> Timer:
        """Call a function at a fixed interval of the steady clock."""
        return self.create_timer(seconds, callback, clock=self._steady)

    def once(self, callback: Callable[[], object]) -> None:
        """Call a function once, as soon as the node spins."""

        def call() -> None:
            timer.cancel()
            callback()

        timer = self.every(1e-3, call)

    def service(self, name: str, action: Callable[[], str]) -> None:
        """Offer the service `~/name` (std_srvs/Trigger)."""

        def answer(request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            try:
                response.success, response.message = True, action()
            except InputError as error:
                response.success, response.message = False, str(error)
            return response

        self.create_service(Trigger, f"~/{name}", answer)

    def finish(self, publisher: Publisher, code: int = 0) -> None:
        """End the node once every subscriber has received the messages of a publisher."""
        if not self.finished.done():
            publisher.wait_for_all_acked(Duration(seconds=2))
            self.finished.set_result(code)
