"""Sending and receiving, with a middleware that is made up: one that takes no bytes, and messages that are none."""

from __future__ import annotations

import numpy as np
import pytest
from std_msgs.msg import Float64MultiArray, MultiArrayDimension

from hyst_control.nodes.signal_node.message_io import CallbackSubscription, PolledSubscription, Sender, from_message, to_message
from hyst_control.records.stream.signal_message import Encoder

LABEL = "t[s],x[V]"
BLOCK = np.array([[0.0, 1.0], [0.1, 2.0]])
RAW = Encoder(LABEL).encode(BLOCK)


class Middleware:
    """A node, its publisher and its subscription in one."""

    def __init__(self, takes_bytes=True, failure=TypeError):
        self.takes_bytes, self.failure = takes_bytes, failure
        self.published, self.waiting, self.subscribers = [], [], 0
        self.topic_name = "/topic"
        self.handle = self

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None

    def create_publisher(self, *_):
        return self

    def create_subscription(self, kind, topic, callback, qos, raw=False):
        if raw and not self.takes_bytes:
            raise self.failure("no bytes")
        self.callback, self.raw = callback, raw
        return self

    def publish(self, message):
        if isinstance(message, bytes) and not self.takes_bytes:
            raise self.failure("no bytes")
        self.published.append(message)

    def get_subscription_count(self):
        return self.subscribers

    def take_message(self, kind, raw):
        return (self.waiting.pop(0), {"received_timestamp": 5}) if self.waiting else None


class Receiver:
    """A receiver in the same process."""

    topic, raw = "/topic", True

    def __init__(self):
        self.handed = []

    def hand(self, raw, label, block):
        self.handed.append(raw)


@pytest.mark.parametrize("failure", [TypeError, NotImplementedError])
def test_a_middleware_that_takes_no_bytes_gets_message_objects(failure):
    node = Middleware(False, failure)
    sender = Sender(node, "topic", LABEL)
    for _ in range(2):
        sender.send(BLOCK)
    assert len(node.published) == 2
    for message in node.published:
        label, block = from_message(message)
        assert label == LABEL
        np.testing.assert_array_equal(block, BLOCK)
    got = []
    subscription = CallbackSubscription(node, "topic", lambda *message: got.append(message), pytest.fail)
    assert not subscription.raw and not node.raw
    node.callback(to_message(LABEL, BLOCK))
    assert got[0][0] == LABEL


def test_messages_go_directly_as_long_as_nobody_else_listens():
    node, receiver = Middleware(), Receiver()
    sender = Sender(node, "topic", LABEL)
    sender.link([receiver])
    node.subscribers = 1
    sender.send(BLOCK)
    assert receiver.handed == [RAW] and not node.published
    node.subscribers = 2
    sender.send(BLOCK)
    node.subscribers = 1  # messages of the two ways could overtake each other: never again
    sender.send(BLOCK)
    assert len(receiver.handed) == 1 and node.published == [RAW, RAW]


def wrong_object():
    message = Float64MultiArray(data=[1.0, 2.0, 3.0])
    message.layout.dim = [MultiArrayDimension(label="rows", size=2), MultiArrayDimension(label=LABEL, size=2)]
    return message


def test_a_message_that_is_none_is_refused_with_a_reason_and_the_next_is_taken():
    refused, got = [], []
    node = Middleware()
    CallbackSubscription(node, "topic", lambda *message: got.append(message), refused.append)
    node.callback(RAW[:-3])
    node.callback(RAW)
    assert len(refused) == len(got) == 1 and refused[0]
    other = Middleware()
    CallbackSubscription(other, "topic", lambda *message: got.append(message), refused.append, objects=True)
    other.callback(wrong_object())
    other.callback(to_message(LABEL, BLOCK))
    assert len(refused) == len(got) == 2 and refused[1]


@pytest.mark.parametrize("merge", [False, True])
def test_polling_refuses_one_message_and_takes_the_others(merge):
    refused = []
    node = Middleware()
    subscription = PolledSubscription(node, "topic")
    node.waiting = [RAW, RAW[:-3], RAW, RAW]
    taken = subscription.take(refused.append, merge)
    assert len(refused) == 1 and sum(len(block) for _, block, _ in taken) == 6
    assert len(taken) == (2 if merge else 3) and {(label, stamp) for label, _, stamp in taken} == {(LABEL, 5)}
    objects = PolledSubscription(node, "topic", objects=True)
    node.waiting = [wrong_object(), to_message(LABEL, BLOCK)]
    assert len(objects.take(refused.append)) == 1 and len(refused) == 2


def test_what_was_handed_over_comes_before_what_the_middleware_carried():
    got = []
    node = Middleware()
    subscription = CallbackSubscription(node, "topic", lambda label, block: got.append(block[0, 1]), pytest.fail)
    row = np.array([[0.0, 7.0]])
    subscription.hand(Encoder(LABEL).encode(row), LABEL, row)
    node.callback(RAW)
    subscription.take()
    assert got == [7.0, 1.0]
