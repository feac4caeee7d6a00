"""Running nodes: one process, one executor, a clean end on every way out."""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.task import Future

from hyst_control.errors import InputError
from hyst_control.launch import environment
from hyst_control.nodes.base import EndingNode

FOREVER = 1e6  # s
INTERRUPT_LATENCY = 0.01  # s, in which a signal that rclpy has heard reaches Python


def spin(executor: Any, future: Future, timeout: float = FOREVER) -> None:
    """Spin until the future is done; an EventsExecutor that spins without a timeout runs no callback, hears no signal."""
    executor.spin_until_future_complete(future, timeout_sec=timeout)


def run(nodes: Sequence[EndingNode], context: Context, timeout: float = FOREVER) -> int | None:
    """Spin the nodes on one executor until all that end by themselves have ended; the greatest of their exit statuses.

    None when that took longer than the timeout (s). The nodes are closed and destroyed whatever happens.
    """
    executor = EventsExecutor(context=context)
    ended, waiting = Future(), [node for node in nodes if node.ends]

    def one_ended(_: Future) -> None:
        if all(node.finished.done() for node in waiting):
            ended.set_result(max(node.finished.result() for node in waiting))

    try:
        for node in nodes:
            executor.add_node(node)
        for node in waiting:
            node.finished.add_done_callback(one_ended)
        spin(executor, ended, timeout)
        return ended.result() if ended.done() else None
    finally:
        close(nodes)
        executor.shutdown()


def close(nodes: Sequence[EndingNode]) -> None:
    """Close and destroy nodes, also when one of them fails to."""
    for node in nodes:
        try:
            node.close()
        finally:
            node.destroy_node()


def main(*factories: Callable[[], EndingNode], args: Sequence[str] | None = None) -> int:
    """Body of an executable: 0 when it ended by itself or was interrupted, 2 on bad input, told in one line."""
    environment.prepare()
    try:
        return _body(factories, args)
    except KeyboardInterrupt:
        # rclpy hears the signal first, in a thread of its own: Python's interrupt may come while the nodes are being closed.
        return 0
    finally:
        signal.signal(signal.SIGINT, signal.SIG_IGN)  # a second Ctrl-C during the shutdown would leave a traceback
        rclpy.try_shutdown()


def _body(factories: Sequence[Callable[[], EndingNode]], args: Sequence[str] | None) -> int:
    nodes: list[EndingNode] = []
    try:
        rclpy.init(args=args)
        for factory in factories:
            nodes.append(factory())
        return run(nodes, rclpy.get_default_context()) or 0
    except ExternalShutdownException:
        # Python's own interrupt of the same Ctrl-C is still to come: let it come here, where it is waited for.
        time.sleep(INTERRUPT_LATENCY)
        return 0
    except InputError as error:
        close(nodes)
        print(error, file=sys.stderr)
        return 2
