"""Sending and receiving signal blocks: serialized bytes where the middleware takes them, message objects otherwise."""

from __future__ import annotations

import array
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from hyst_control.signal_message import ROW_LABEL, Decoder, Encoder

Array = NDArray[np.float64]

# Every sample counts: reliable, and a queue that holds what a recorder may lag behind.
QUEUE = QoSProfile(history=QoSHistoryPolicy.KEEP_LAST, depth=5000, reliability=QoSReliabilityPolicy.RELIABLE)


class Sender:
    """Publishes blocks (N, C) of one topic."""

    def __init__(self, node: Node, topic: str, label: str, objects: bool = False) -> None:
        self.publisher = node.create_publisher(Float64MultiArray, topic, QUEUE)
        self._encoder = Encoder(label)
        self._objects = objects

    def send(self, block: Array) -> None:
        """Publish a block (N, C), column 0 the sample time in s."""
        if not self._objects:
            try:
                self.publisher.publish(self._encoder.encode(block))
                return
            except (TypeError, NotImplementedError):  # a middleware that takes message objects only
                self._objects = True
        self.publisher.publish(to_message(self._encoder.label, block))


def receive(node: Node, topic: str, callback: Callable[[str, Array], None], refused: Callable[[str], None],
            objects: bool = False) -> Any:
    """Subscribe to a topic: `callback(label, block (N, C))` for a message, `refused(reason)` for what is none."""
    decoder = Decoder()

    def on_bytes(raw: bytes) -> None:
        try:
            label, block = decoder.decode(raw)
        except ValueError as error:
            refused(str(error))
            return
        callback(label, block)

    def on_message(message: Float64MultiArray) -> None:
        try:
            label, block = from_message(message)
        except ValueError as error:
            refused(str(error))
            return
        callback(label, block)

    if not objects:
        try:
            return node.create_subscription(Float64MultiArray, topic, on_bytes, QUEUE, raw=True)
        except (TypeError, NotImplementedError):
            pass
    return node.create_subscription(Float64MultiArray, topic, on_message, QUEUE)


class Intake:
    """A subscription whose messages are taken when it suits the owner, many at a time, instead of one callback for each."""

    def __init__(self, node: Node, topic: str, objects: bool = False) -> None:
        self._decoder, self._objects = Decoder(), objects
        self.subscription = node.create_subscription(Float64MultiArray, topic, lambda message: None, QUEUE, raw=not objects)

    def take(self, refused: Callable[[str], None], merge: bool = False) -> list[tuple[str, Array, int]]:
        """(label, block (N, C), time of reception in ns) of every message that has arrived; `refused(reason)` for what is none.

        At most as many messages as the queue holds: a source that sends faster than this takes must not keep the owner here.
        merge: successive messages of one form become one block, received when the last of them was.
        """
        handle, raw = self.subscription.handle, not self._objects
        found: list[tuple[Any, int]] = []
        with handle:
            while len(found) < QUEUE.depth and (message := handle.take_message(Float64MultiArray, raw)) is not None:
                found.append((message[0], message[1]["received_timestamp"] or time.time_ns()))
        taken: list[tuple[str, Array, int]] = []
        begin = 0
        while begin < len(found):
            end = begin + 1
            try:
                label, block = self._decoder.decode(found[begin][0]) if raw else from_message(found[begin][0])
                if merge and raw and label:
                    size, head = len(found[begin][0]), found[begin][0][:-block.nbytes]
                    while end < len(found) and len(found[end][0]) == size and found[end][0].startswith(head):
                        end += 1
                    if end - begin > 1:
                        data = b"".join([message[len(head):] for message, _ in found[begin:end]])
                        block = np.frombuffer(data, np.float64).reshape(-1, block.shape[1])
                taken.append((label, block, found[end - 1][1]))
            except ValueError as error:
                refused(str(error))
            begin = end
        return taken


def to_message(label: str, block: Array) -> Float64MultiArray:
    """The message object of a block (N, C)."""
    rows, columns = block.shape
    message = Float64MultiArray(data=array.array("d", block.tobytes()))  # an ndarray would be copied item by item
    message.layout.dim = [MultiArrayDimension(label=ROW_LABEL, size=rows, stride=rows * columns),
                          MultiArrayDimension(label=label, size=columns, stride=columns)]
    return message


def from_message(message: Float64MultiArray) -> tuple[str, Array]:
    """Label and block (N, C) of a message object; the label is "" when it has no layout. Raises ValueError."""
    data = np.frombuffer(message.data, np.float64)
    if not message.layout.dim:
        return "", data.reshape(1, -1)
    _, columns = message.layout.dim
    return columns.label, data.reshape(-1, columns.size)
