"""Nodes composed in one process hand their messages to each other: the middleware takes 40 us for what is a call of a function."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

from hyst_control.nodes.base import EndingNode, SignalNode
from hyst_control.nodes.message_io import CallbackSubscription, LocalReceiver

MOST_AT_ONCE = 64
"""Messages that are taken before the executor has its turn again, for timers, services and what comes from outside."""


def hand_over(nodes: Sequence[EndingNode], executor: Any, failed: Callable[[BaseException], None]) -> None:
    """Link the senders of nodes on one executor with the receivers of the same topics.

    Parameters
    ----------
    nodes : sequence of EndingNode
        The nodes of the executor.
    executor : EventsExecutor
        The executor.
    failed : callable
        Told what a callback raised.
    """
    signal_nodes = [node for node in nodes if isinstance(node, SignalNode)]
    if len(signal_nodes) < 2:
        return
    exchange = _Exchange(executor, failed)
    receivers: list[LocalReceiver] = []
    for node in signal_nodes:
        receivers += [*node.receptions, *node.polled]
    for receiver in receivers:
        if isinstance(receiver, CallbackSubscription):
            receiver.post = exchange.post
    for node in signal_nodes:
        for sender in node.senders:
            sender.link([receiver for receiver in receivers if receiver.topic == sender.topic])


class _Exchange:
    """The order in which handed messages are taken: one after the other by a task of the executor, never within a node's callback."""

    def __init__(self, executor: Any, failed: Callable[[BaseException], None]) -> None:
        self._executor, self._failed = executor, failed
        self._due: deque[CallbackSubscription] = deque()
        self._scheduled = False

    def post(self, reception: CallbackSubscription) -> None:
        self._due.append(reception)
        if not self._scheduled:
            self._scheduled = True
            self._executor.create_task(self._take)

    def _take(self) -> None:
        due = self._due
        try:
            for _ in range(MOST_AT_ONCE):
                if not due:
                    self._scheduled = False
                    return
                due.popleft().take()
            self._executor.create_task(self._take)
        except BaseException as error:  # the EventsExecutor crashes on a task that raises
            self._failed(error)
