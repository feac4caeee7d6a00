# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Running of nodes: one process, one executor, and a clean shutdown however it ends."""

from __future__ import annotations

import gc
import os
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from functools import partial
from typing import Any

import rclpy
from rclpy.context import Context
from rclpy.exceptions import NameValidationException, NotInitializedException
from rclpy.executors import Executor, ExternalShutdownException
from rclpy.experimental import EventsExecutor
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future
from rclpy.utilities import remove_ros_args

from hyst_control.base.errors import InputError
from hyst_control.nodes.execution import command_line, interrupts
from hyst_control.nodes.execution.ending_node import EndingNode
from hyst_control.nodes.execution.exit_watchdog import exit_within
from hyst_control.nodes.execution.intra_process import hand_over
from hyst_control.nodes.signal_node.base import SignalNode
from hyst_control.nodes.signal_node.timer import Timer
from hyst_control.processes import environment

FOREVER = 1e6  # s
SECURITY_REMEDY = (
    "give a keystore with this enclave, and a ROS of a distribution: that of the wheels has no security (docs/safety.md)"
)
LONGEST_WIND_DOWN = 8.0  # s, for which an actuator is brought to its safe value after an interrupt; then its watchdog has to do so


def spin(executor: Executor, future: Future, timeout: float = FOREVER) -> None:
    """Spin until a future is done, with a timeout: without one an EventsExecutor runs no callbacks and handles no signals."""
    executor.spin_until_future_complete(future, timeout_sec=timeout)


def run(
    nodes: Sequence[EndingNode], context: Context, timeout: float = FOREVER, on_closed: Callable[[int], None] = lambda status: None
) -> int | None:
    """Spin nodes on one executor until all that end by themselves have ended; close and destroy them in any case."""
    executor = EventsExecutor(context=context)
    ended, waiting = Future(), [node for node in nodes if node.ends or len(nodes) == 1]  # alone, a node may also fail

    def one_ended(_: Future) -> None:
        if all(node.finished.done() for node in waiting):
            ended.set_result(max(node.finished.result() for node in waiting))

    def failed(error: BaseException) -> None:
        if not ended.done():
            ended.set_exception(error)

    try:
        tick_together(nodes)
        for node in nodes:
            executor.add_node(node)
        for node in waiting:
            node.finished.add_done_callback(one_ended)
        hand_over(nodes, executor, failed)
        gc.collect()
        gc.freeze()  # present objects stay: examining them again and again would cost ticks
        graceful = all(isinstance(node, SignalNode) for node in nodes)  # others compute for long in a callback
        with interrupts.delivered(lambda: failed(KeyboardInterrupt()), graceful):
            try:
                spin(executor, ended, timeout)
                return ended.result() if ended.done() else None
            except KeyboardInterrupt:
                wind_down(nodes, executor)
                raise
    finally:
        expected = isinstance(sys.exc_info()[1], (type(None), KeyboardInterrupt, ExternalShutdownException))
        with interrupts.ignored():
            gc.unfreeze()
            status = ended.result() if ended.done() and ended.exception() is None else 0
            close(nodes, lambda: on_closed(status) if expected else None)
            executor.shutdown()


def wind_down(nodes: Sequence[EndingNode], executor: Executor) -> None:
    """Spin nodes until each has left its actuator at the safe value, or a second interrupt comes."""
    for node in nodes:
        node.wind_down()
    over, end = Future(), time.monotonic() + LONGEST_WIND_DOWN

    def look() -> None:
        if not over.done() and (all(node.wound_down for node in nodes) or time.monotonic() > end):
            over.set_result(None)

    look()
    if not over.done():
        timer = nodes[0].every(0.01, look)
        spin(executor, over)  # not for a short time again and again: an executor with events at hand does not look at the time
        timer.cancel()
    for node in nodes:
        if not node.wound_down:
            node.get_logger().warning(f"ended after {LONGEST_WIND_DOWN:g} s, before the command was at its safe value")


def tick_together(nodes: Sequence[EndingNode]) -> None:
    """Tick all nodes of equal interval by one timer, in the order of their phases, because every timer wakes two threads."""
    timers = [node.schedule for node in nodes if isinstance(node, SignalNode) and isinstance(node.schedule, Timer)]
    paced = [timer for timer in timers if timer.paced]
    for interval in {timer.interval for timer in paced}:
        group = sorted((timer for timer in paced if timer.interval == interval), key=lambda timer: timer.phase)
        if len(group) > 1:
            for timer in group[1:]:
                timer.call_instead(None)
            group[0].call_instead(partial(_tick, group))


def _tick(group: Sequence[Timer]) -> None:
    now = time.monotonic()
    for timer in group:
        timer.call(now)


def close(nodes: Sequence[EndingNode], closed: Callable[[], None] = lambda: None) -> None:
    """Close nodes, call `closed`, then destroy the nodes; a failure of one does not keep the others from it."""
    with ExitStack() as last_first:
        for node in nodes:
            last_first.callback(node.destroy_node)
        last_first.callback(closed)
        for node in nodes:
            last_first.callback(node.close)


def main(*factories: Callable[[], EndingNode], args: Sequence[str] | None = None) -> int:
    """Run the body of an executable."""
    given = list(sys.argv if args is None else args)
    if command_line.wants_help(given):
        print(command_line.help_text(given[0], factories))
        return 0
    exposed = environment.exposure()
    try:
        for warning in command_line.check(given, _classes(factories)):
            print(warning, file=sys.stderr)
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    if exposed:
        print(exposed, file=sys.stderr)
    environment.prepare()
    interrupts.listen()
    interrupts.end_with_parent()
    try:
        return _body(factories, given)
    except KeyboardInterrupt:
        return 0
    except (RuntimeError, NotInitializedException):
        # rclpy fails in several ways on an interrupt during one of its calls, and on a message whose context no longer exists.
        if interrupts.received() or not rclpy.ok():
            return 0
        raise
    finally:
        interrupts.ignore()  # a second Ctrl-C during the shutdown would leave a traceback
        with suppress(RuntimeError):  # rclpy's own signal handler may have done it
            rclpy.try_shutdown()


def executable(factory: Callable[[], EndingNode]) -> Callable[[], int]:
    """Make the `main` of a node: it runs the executable and returns its exit status."""
    return partial(main, factory)


def _initialize(args: Sequence[str]) -> None:
    try:
        rclpy.init(args=list(args), signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:  # rclpy's own exceptions: arguments or parameter files that it cannot read
        text = " ".join(str(error).split()).removeprefix("failed to initialize rcl: ").partition(", at ")[0]
        if _secured():
            raise InputError(f"security: {text}: {SECURITY_REMEDY}") from None
        raise InputError(f"ROS arguments: {text}: in a parameter file quote texts such as 'y', 'on' or 'no'") from None
    command_line.check_rest(args[0], remove_ros_args(list(args))[1:])


def _parameters_of(factories: Sequence[Any]) -> frozenset[str]:
    """Names of the parameters of all nodes of a process with several, since `-p NAME:=VALUE` reaches every one of them."""
    if len(factories) < 2:
        return frozenset()
    return frozenset(setting.name for each in _classes(factories) for setting in (*each.COMMON_SETTINGS, *each.SETTINGS))


def _classes(factories: Sequence[Any]) -> list[type[EndingNode]]:
    return [factory for factory in factories if isinstance(factory, type) and issubclass(factory, EndingNode)]


def _secured() -> bool:
    return os.environ.get("ROS_SECURITY_ENABLE", "").lower() == "true"


def _made(factory: Callable[[], EndingNode]) -> EndingNode:
    try:
        return factory()
    except InputError:
        raise
    except NameValidationException as error:  # of a topic that a parameter names
        raise InputError(f"{command_line.name_refusal(error)}: choose another name") from None
    except Exception as error:
        if not _secured():
            raise
        text = " ".join(str(error).split()).removeprefix("error creating node: ").partition(", at ")[0]
        raise InputError(f"security: {text}: {SECURITY_REMEDY}") from None


def _body(factories: Sequence[Callable[[], EndingNode]], args: Sequence[str]) -> int:
    nodes: list[EndingNode] = []
    try:
        _initialize(args)
        EndingNode.elsewhere, EndingNode.named = _parameters_of(factories), command_line.given_by_name(args)
        for factory in factories:
            nodes.append(_made(factory))
        if interrupts.received():  # a library has suppressed the interrupt
            close(nodes, lambda: exit_within(0))
            return 0
        return run(nodes, rclpy.get_default_context(), on_closed=exit_within) or 0
    except ExternalShutdownException:
        return 0
    except InputError as error:
        print(error, file=sys.stderr)
        close(nodes, lambda: exit_within(2))
        return 2
