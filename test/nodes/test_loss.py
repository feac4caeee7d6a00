"""Lockstep heals what the middleware loses: whichever message does not reach whichever node, the record is the offline computation."""

from __future__ import annotations

import signal
import time

import numpy as np
import pytest
from loop_case import assert_same_bits, offline, parameters, recorded
from rclpy.parameter import Parameter

from hyst_control.nodes.execution import interrupts
from hyst_control.nodes.execution.run import run
from hyst_control.nodes.pipeline import node_class
from hyst_control.nodes.recorder import Recorder
from hyst_control.records.stream.signal_rows import GAP_PATIENCE

PERIOD = 1e-3
LISTENERS = [
    ("reference_generator", "measurement"),
    ("hampi_feedforward", "reference"),
    ("pi_feedback", "feedforward"),
    ("pi_feedback", "reference"),
    ("pi_feedback", "measurement"),
    ("plant", "command"),
    *(("recorder", topic) for topic in ("reference", "feedforward", "feedback", "command", "measurement")),
]


class Lossy:
    """In place of a receiver's `hand`: some of the messages do not arrive."""

    def __init__(self, receiver, lost):
        self.hand, self.lost, self.count, self.missed = receiver.hand, lost, 0, 0
        receiver.hand = self

    def __call__(self, raw, label, block):
        if self.count in self.lost:
            self.missed += 1
        else:
            self.hand(raw, label, block)
        self.count += 1


def composed(context, settings, lost):
    """Run the loop; `lost`: numbers of messages by (node, topic)."""
    nodes = {
        name: node_class(name)(context=context, parameter_overrides=[Parameter(key, value=value) for key, value in own.items()])
        for name, own in settings.items()
    }
    lossy = {
        (name, topic): Lossy(receiver, lost[name, topic])
        for name, node in nodes.items()
        for receiver in (*node.receptions, *node.polled)
        for topic in [receiver.topic.strip("/")]
        if (name, topic) in lost
    }
    assert set(lossy) == set(lost)
    assert run(list(nodes.values()), context, timeout=60.0) == 0
    assert all(each.missed for each in lossy.values())


@pytest.mark.parametrize("listener", LISTENERS, ids="/".join)
def test_messages_that_one_node_lacks_come_again(tmp_path, ros_context, listener):
    settings = parameters(tmp_path, 300, plant={"retry": 0.05})
    composed(ros_context, settings, {listener: {1, 2, 90, 290}})
    assert_same_bits(recorded(tmp_path / "bag"), offline(300))


@pytest.mark.parametrize("block", [1, 64])
def test_messages_lost_everywhere_come_again(tmp_path, ros_context, block):
    """Streamed ahead, where a node that lacks rows is left behind by those that do not."""
    draw = np.random.default_rng(block)
    settings = parameters(
        tmp_path,
        1500,
        reference_generator={"block": block, "lead": 700},
        recorder={"merge": 8},
        pi_feedback={"feedback": False},
        plant={"retry": 0.05},
    )
    listeners = [each for each in LISTENERS if each[0] != "pi_feedback" or each[1] == "feedforward"]
    composed(ros_context, settings, {each: set(draw.choice(np.arange(1, 8), 3, replace=False)) for each in listeners})
    assert_same_bits(recorded(tmp_path / "bag"), offline(1500, feedback=False))


def rows(first, last):
    ticks = np.arange(first, last)
    return np.column_stack([ticks * PERIOD, ticks])


def test_rows_that_never_come_again_are_a_gap_after_a_while(bench, tmp_path, monkeypatch):
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    node = bench.add(Recorder, output=str(tmp_path / "bag"), topics=["command"], rate_hz=1 / PERIOD, merge=4)
    [command] = node._topics
    arriving = []
    command._intake.take = lambda refused, merge: [("t[s],x[V]", arriving.pop(0), 0)] if arriving else []
    for first, last in ((0, 10), (12, 20), (30, 33)):
        arriving.append(rows(first, last))
        command.drain()
    now[0] += 0.9 * GAP_PATIENCE
    command.drain()
    node.progress()
    assert node.last_complete_tick == 9 and command.rows.end == 10
    now[0] += 0.2 * GAP_PATIENCE
    command.drain()
    assert command.rows.end == 33 and node.counts["/command: missed ticks"] == 12
    arriving.append(rows(33, 40))
    command.drain()
    node.close()
    np.testing.assert_array_equal(recorded(tmp_path / "bag")["command"], np.concatenate([rows(0, 10), rows(12, 20), rows(30, 40)]))


def test_what_waits_behind_a_gap_is_bounded(bench, tmp_path):
    node = bench.add(Recorder, output=str(tmp_path / "bag"), topics=["command"], rate_hz=1 / PERIOD, most_waiting=100)
    [command] = node._topics
    arriving = [rows(0, 10), rows(11, 100), rows(100, 110), rows(110, 120)]
    command._intake.take = lambda refused, merge: [("t[s],x[V]", arriving.pop(0), 0)] if arriving else []
    ends = []
    while arriving:
        command.drain()
        ends.append(command.rows.end)
    assert ends == [10, 10, 10, 120]


def test_rows_behind_a_gap_are_kept_when_the_recorder_is_closed(bench, tmp_path):
    node = bench.add(Recorder, output=str(tmp_path / "bag"), topics=["command"], rate_hz=1 / PERIOD)
    [command] = node._topics
    for first, last in ((0, 10), (12, 20), (14, 25)):
        command.receive("t[s],x[V]", rows(first, last))
    node.close()
    np.testing.assert_array_equal(recorded(tmp_path / "bag")["command"], np.concatenate([rows(0, 10), rows(12, 25)]))


def test_an_interrupt_while_messages_are_taken_loses_none_of_them(bench, tmp_path, listening):
    node = bench.add(Recorder, output=str(tmp_path / "bag"), topics=["command", "measurement"], rate_hz=1 / PERIOD)
    arriving = [rows(0, 10), rows(10, 20), rows(20, 30), rows(30, 40)]

    def take(refused, merge):
        if not arriving:
            return []
        signal.raise_signal(signal.SIGINT)
        return [("t[s],x[V]", arriving.pop(0), 0)]

    for topic in node._topics:
        topic._intake.take = take
    with pytest.raises(KeyboardInterrupt):
        node._drain()
    with interrupts.ignored():
        node.close()
    found = recorded(tmp_path / "bag")
    np.testing.assert_array_equal(found["command"], np.concatenate([rows(0, 10), rows(20, 30)]))
    np.testing.assert_array_equal(found["measurement"], np.concatenate([rows(10, 20), rows(30, 40)]))
