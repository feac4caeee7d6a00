"""Nodes in one process hand messages over to each other; from when somebody outside listens, the middleware carries them, in order."""

from __future__ import annotations

import numpy as np
import pytest
from loop_case import RATE, SIGNALS, assert_same_bits, offline, parameters, recorded
from rclpy.parameter import Parameter

from hyst_control.nodes.execution.ending_node import EndingNode
from hyst_control.nodes.execution.run import run
from hyst_control.nodes.pipeline import DEFAULT, node_class
from hyst_control.nodes.reference_generator import ReferenceGenerator
from hyst_control.nodes.signal_node.message_io import CallbackSubscription


class Late(EndingNode):
    """Begins to listen to a topic while the others run."""

    def __init__(self, topic, due, **options):
        super().__init__("late", **options)
        self.heard = []
        self._topic, self._due = topic, due
        self._timer = self.every(0.005, self._join)

    def _join(self):
        if self._due():
            self._timer.cancel()
            CallbackSubscription(self, self._topic, lambda label, block: self.heard.append(block.copy()), pytest.fail)


def make(context, kind, settings):
    return kind(context=context, parameter_overrides=[Parameter(key, value=value) for key, value in settings.items()])


def sent_by_middleware(monkeypatch, nodes):
    """Messages of every topic that go through the middleware, counted from now on."""
    counts = {}
    for sender in (sender for node in nodes for sender in node.senders):

        def publish(message, topic=sender.topic, publish=sender.publisher.publish):
            counts[topic] = counts.get(topic, 0) + 1
            publish(message)

        monkeypatch.setattr(sender.publisher, "publish", publish)
    return counts


@pytest.mark.parametrize("schedule", ["lockstep", "timer"])
def test_nothing_goes_through_the_middleware_while_nobody_outside_listens(tmp_path, ros_context, monkeypatch, schedule):
    settings = parameters(tmp_path, 500)
    for own in settings.values():
        own["schedule"] = schedule
        own["rate_hz"] = RATE if schedule == "lockstep" else 500.0
    nodes = [make(ros_context, node_class(name), settings[name]) for name in DEFAULT]
    counts = sent_by_middleware(monkeypatch, nodes)
    assert run(nodes, ros_context, timeout=60.0) == 0
    assert counts == {}
    found = recorded(tmp_path / "bag")
    assert all(len(found[topic]) >= 499 for topic in SIGNALS)


def test_who_joins_in_the_middle_hears_every_row_from_then_on_and_the_loop_goes_on_to_the_bit(tmp_path, ros_context, monkeypatch):
    count = 6000
    settings = parameters(tmp_path, count)
    nodes = [make(ros_context, node_class(name), settings[name]) for name in DEFAULT]
    plant = nodes[DEFAULT.index("plant")]
    late = Late("measurement", lambda: plant.status()["tick"] > 500, context=ros_context)
    counts = sent_by_middleware(monkeypatch, nodes)
    assert run([*nodes, late], ros_context, timeout=60.0) == 0
    ticks = np.rint(np.concatenate(late.heard)[:, 0] * RATE).astype(int)
    assert 0 < ticks[0] < count // 2 and ticks[-1] > count // 2
    assert np.array_equal(ticks, np.arange(ticks[0], ticks[-1] + 1))
    assert set(counts) == {"/measurement"}
    assert_same_bits(recorded(tmp_path / "bag"), offline(count))
    assert not any(": out of order" in key or ": missed" in key for node in nodes for key in node.counts)


def test_what_was_handed_over_is_taken_before_what_the_middleware_brings(ros_context):
    node = make(ros_context, ReferenceGenerator, {"signal": "sine", "frequency": 5.0, "amplitude": 1.0})
    try:
        heard = []
        reception = CallbackSubscription(node, "x", lambda label, block: heard.append(block[0, 0]), pytest.fail)
        encode = node.senders[0]._encoder.encode
        for tick in range(3):
            row = np.array([[float(tick), 0.0]])
            reception.hand(encode(row), "time[s],x[V]", row)
        reception._on_bytes(encode(np.array([[3.0, 0.0]])))
        reception.take()
        assert heard == [0.0, 1.0, 2.0, 3.0]
    finally:
        node.destroy_node()


@pytest.mark.parametrize("error, statuses", [(ZeroDivisionError, []), (KeyboardInterrupt, [0])])
def test_what_a_node_raises_in_a_callback_ends_the_run_with_it(tmp_path, ros_context, error, statuses):
    """An interrupt among it: all that is left then is to destroy the nodes."""
    settings = parameters(tmp_path, 200)
    nodes = [make(ros_context, node_class(name), settings[name]) for name in DEFAULT]
    plant = nodes[DEFAULT.index("plant")]
    advance = plant.advance

    def broken():
        if plant.status()["tick"] > 20:
            raise error("in a callback")
        advance()

    plant.advance, told = broken, []
    with pytest.raises(error, match="in a callback"):
        run(nodes, ros_context, timeout=60.0, on_closed=told.append)
    assert told == statuses
