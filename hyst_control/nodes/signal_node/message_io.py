# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Sending and receiving of signal blocks: serialized bytes if the middleware takes them, else message objects."""

from __future__ import annotations

import array
import math
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Annotated, Any, TypeAlias

import numpy as np
from rclpy.node import Node
from rclpy.qos import QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from hyst_control.base.arrays import Array
from hyst_control.records.stream.signal_message import ROW_LABEL, Decoder, Encoder

LOOK_INTERVAL = 0.01  # s, between two looks beyond the process, for subscribers or messages, while there is enough to do in it

# Every sample counts: reliable delivery, and a queue as long as the lag that a recorder may have.
QUEUE = QoSProfile(history=QoSHistoryPolicy.KEEP_LAST, depth=5000, reliability=QoSReliabilityPolicy.RELIABLE)


class Sender:
    """Publisher of the blocks (N, C) of one topic.

    After `link`, messages are handed directly to the receivers within the process as long as these are the only subscribers. Once
    another subscriber has been seen, all messages go through the middleware from then on: otherwise messages of the two ways could
    overtake each other.
    """

    def __init__(self, node: Node, topic: str, label: str, objects: bool = False, look_interval: float = 0.0) -> None:
        self.publisher = node.create_publisher(Float64MultiArray, topic, QUEUE)
        self.topic = self.publisher.topic_name
        self.within = False  # True while messages are handed over within the process
        self._encoder = Encoder(label)
        self._objects = objects
        self._receivers: Sequence[LocalReceiver] = ()
        self._look_interval, self._looked = look_interval, -math.inf

    def link(self, receivers: Sequence[LocalReceiver]) -> None:
        """Hand messages directly to receivers within the process."""
        self._receivers, self.within = receivers, not self._objects and all(receiver.raw for receiver in receivers)

    def send(self, block: Annotated[Array, "N C"]) -> None:
        """Publish a block."""
        if not self._objects:
            message = self._encoder.encode(block)
            if self.within:
                now = time.monotonic()
                if now - self._looked >= self._look_interval:
                    self.within, self._looked = self.publisher.get_subscription_count() <= len(self._receivers), now
                if self.within:
                    for receiver in self._receivers:
                        receiver.hand(message, self._encoder.label, block)
                    return
            try:
                self.publisher.publish(message)
                return
            except (TypeError, NotImplementedError):  # a middleware that takes message objects only
                self._objects = True
        self.publisher.publish(to_message(self._encoder.label, block))


class CallbackSubscription:
    """Subscription with a callback for every message."""

    def __init__(
        self, node: Node, topic: str, callback: Callable[[str, Array], None], refused: Callable[[str], None], objects: bool = False
    ) -> None:
        self._callback, self._refused, self._decoder = callback, refused, Decoder()
        self.raw = not objects
        self.post: Callable[[CallbackSubscription], None] | None = None
        """Called for every message that was handed over, to arrange a call of `take`."""
        self._handed: deque[tuple[str, Array]] = deque()
        if self.raw:
            try:
                self.subscription = node.create_subscription(Float64MultiArray, topic, self._on_bytes, QUEUE, raw=True)
            except (TypeError, NotImplementedError):
                self.raw = False
        if not self.raw:
            self.subscription = node.create_subscription(Float64MultiArray, topic, self._on_message, QUEUE)
        self.topic = self.subscription.topic_name

    def hand(self, raw: bytes, label: str, block: Annotated[Array, "N C"]) -> None:
        """Queue a message of a sender in this process."""
        self._handed.append((label, block))
        if self.post is not None:
            self.post(self)

    def take(self) -> None:
        """Deliver the oldest message that was handed over, if there is one."""
        if self._handed:
            self._callback(*self._handed.popleft())

    def _on_bytes(self, raw: bytes) -> None:
        while self._handed:  # they were sent before
            self.take()
        self._deliver(self._decoder.decode, raw)

    def _on_message(self, message: Float64MultiArray) -> None:
        self._deliver(from_message, message)

    def _deliver(self, decode: Callable[[Any], tuple[str, Array]], message: Any) -> None:
        try:
            label, block = decode(message)
        except ValueError as error:
            self._refused(str(error))
            return
        self._callback(label, block)


LocalReceiver: TypeAlias = "CallbackSubscription | PolledSubscription"
"""Receiver within the process, to which messages are handed directly instead of through its subscription."""

# Message, its time in ns since the epoch, and label and rows where they need not be decoded
_Found = tuple[Any, int, str, Array | None]


class PolledSubscription:
    """Subscription without callbacks: its owner takes the messages when it is ready, many at a time."""

    def __init__(self, node: Node, topic: str, objects: bool = False) -> None:
        self._decoder, self.raw = Decoder(), not objects
        self.subscription = node.create_subscription(Float64MultiArray, topic, lambda message: None, QUEUE, raw=self.raw)
        self.topic = self.subscription.topic_name
        self._looked = -math.inf  # s, when the middleware was asked
        self._handed: deque[_Found] = deque(maxlen=QUEUE.depth)  # as many as the middleware would keep

    def hand(self, raw: bytes, label: str, block: Annotated[Array, "N C"]) -> None:
        """Queue a message of a sender in this process."""
        self._handed.append((raw, time.time_ns(), label, block))

    def take(self, refused: Callable[[str], None], merge: bool = False) -> list[tuple[str, Array, int]]:
        """Take the messages that have arrived, at most a queue's: a source faster than its receiver cannot block the owner."""
        handle, raw = self.subscription.handle, self.raw
        found = list(self._handed)  # before those that the middleware carried: they were sent before
        self._handed.clear()
        now = time.monotonic()
        if found and now - self._looked < LOOK_INTERVAL:  # what comes within the process comes from nowhere else, as a rule
            return self._read(found, refused, merge)
        self._looked = now
        with handle:
            while len(found) < QUEUE.depth and (message := handle.take_message(Float64MultiArray, raw)) is not None:
                found.append((message[0], message[1]["received_timestamp"] or time.time_ns(), "", None))
        return self._read(found, refused, merge)

    def _read(self, found: list[_Found], refused: Callable[[str], None], merge: bool) -> list[tuple[str, Array, int]]:
        """Label, block and time of messages, see `take`."""
        raw, decode = self.raw, self._decoder.decode
        taken: list[tuple[str, Array, int]] = []
        begin, count = 0, len(found)
        while begin < count:
            message, stamp, label, block = found[begin]
            begin += 1
            if block is None or merge:
                try:
                    label, block = decode(message) if raw else from_message(message)
                except ValueError as error:
                    refused(str(error))
                    continue
                if merge and raw and label:
                    block, begin, stamp = _joined(found, begin, block, stamp)
            taken.append((label, block, stamp))
        return taken


def _joined(found: list[_Found], begin: int, block: Array, stamp: int) -> tuple[Array, int, int]:
    """A block with those of the messages from `begin` on that have its label and size; behind the last one, and its time."""
    first = found[begin - 1][0]
    size, head, end = len(first), first[: -block.nbytes], begin
    while end < len(found) and len(found[end][0]) == size and found[end][0].startswith(head):
        end += 1
    if end == begin:
        return block, end, stamp
    data = b"".join([message[len(head) :] for message, *_ in found[begin - 1 : end]])
    return np.frombuffer(data, np.float64).reshape(-1, block.shape[1]), end, found[end - 1][1]


def to_message(label: str, block: Annotated[Array, "N C"]) -> Float64MultiArray:
    """Convert a block to a message object."""
    rows, columns = block.shape
    message = Float64MultiArray(data=array.array("d", block.tobytes()))  # an ndarray would be copied item by item
    message.layout.dim = [
        MultiArrayDimension(label=ROW_LABEL, size=rows, stride=rows * columns),
        MultiArrayDimension(label=label, size=columns, stride=columns),
    ]
    return message


def from_message(message: Float64MultiArray) -> tuple[str, Array]:
    """Convert a message object to a block."""
    data = np.frombuffer(message.data, np.float64)
    if not message.layout.dim:
        return "", data.reshape(1, -1)
    _, columns = message.layout.dim
    return columns.label, data.reshape(-1, columns.size)
