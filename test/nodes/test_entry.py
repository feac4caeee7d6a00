# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Where messages of others enter a node: what each receiver refuses, counts and goes on from, message by message."""

from __future__ import annotations

import time

import numpy as np
import pytest
from loop_case import MODEL

from hyst_control.nodes.diagnosis import DiagnosisNode
from hyst_control.nodes.feedforward import Feedforward
from hyst_control.nodes.loop import rival_watch
from hyst_control.nodes.pi_feedback import PiFeedback
from hyst_control.nodes.recorder import Recorder
from hyst_control.nodes.signal_node.message_io import to_message

RATE = 1000.0
PERIOD = 1 / RATE
LABEL = "t[s],x[um]"


def row(tick, *values):
    return np.array([[tick * PERIOD, *values]])


def drops(node, topic):
    return {key.removeprefix(f"{topic}: "): count for key, count in node.counts.items() if key.startswith(topic) and count}


BAD = [
    ("not finite", row(3, np.nan)),
    ("out of range", row(3, 1.7e308)),
    ("out of range", np.array([[1e306, 1.0]])),
    ("off the clock", row(3.5, 1.0)),
]


@pytest.mark.parametrize("schedule", ["lockstep", "timer"])
def test_input_of_a_loop(bench, schedule):
    node = bench.add(lambda **options: Feedforward("feedforward", **options), gain=[10.0], rate_hz=RATE, schedule=schedule)
    node.timer.call_instead(None) if schedule == "timer" else None
    signal, first = node.reference, 0 if schedule == "lockstep" else int(time.monotonic() / PERIOD)
    signal.receive(LABEL, row(first, 1.0))
    signal.receive(LABEL, np.zeros((0, 2)))
    signal.receive("t[s],x[mrad]", row(first + 1, 1.0))
    for kind, bad in BAD:
        count = node.counts[f"reference: {kind}"]
        signal.receive(LABEL, bad)
        assert node.counts[f"reference: {kind}"] == count + 1
    signal.refused("no reason")
    assert node.counts["reference: wrong label"] == node.counts["reference: unreadable"] == 1
    assert signal.rows.end == first + 1
    signal.receive(LABEL, row(first, 1.0))
    signal.receive(LABEL, row(first, 2.0))
    assert drops(node, "reference")["duplicate"] == 2 and node.counts["reference: conflict"] == 1
    if schedule == "lockstep":
        signal.receive(LABEL, row(first + 10**6, 1.0))
        assert node.counts["reference: out of order"] == 1
    else:
        node.timer.clocks.look_at(node.timer.now, node.settings.ahead)
        for ahead in (10**6, 2000):
            signal.receive(LABEL, row(first + ahead, 1.0))
        assert node.counts["reference: far ahead"] == 2
        signal.receive(LABEL, row(first + 3, 1.0))
        assert node.counts["reference: lost"] == 2
        signal.receive(LABEL, row(first + 1, 1.0))
        assert node.counts["reference: late"] == 1
        signal.receive(LABEL, row(first - 5000, 1.0))
        assert node.counts["reference: time ran backwards"] == 1
        node.timer.clocks.look_at(node.timer.now, 1e9)
        signal.receive(LABEL, row(first + 10**7, 1.0))
        assert node.counts["reference: far ahead"] == 3  # further than as many rows as may wait
    signal.receive(LABEL, row(signal.rows.end, 1.0))
    assert signal.rows.end == first + (2 if schedule == "lockstep" else 5)


def test_input_joins_a_run_at_its_beginning_and_takes_no_more_than_may_wait(bench):
    node = bench.add(PiFeedback, rate_hz=RATE, most_waiting=2)
    signal = node.reference
    signal.receive(LABEL, row(7, 1.0))
    assert node.counts["reference: joining"] == 1 and signal.rows.end is None
    for tick in range(3):
        signal.receive(LABEL, row(tick, 1.0))
    assert node.counts["reference: too many waiting"] == 1 and signal.rows.available == 2


def cut_short():
    """A message of fewer values than its layout announces."""
    message = to_message("t[s],x[V]", row(0, 1.0))
    message.data = message.data[:1]
    return message


def test_signal_that_is_only_watched(bench):
    node = bench.add(DiagnosisNode, model=MODEL, rate_hz=RATE)
    signal = node._measurement
    signal.receive(row(0, 1.0))
    for kind, bad in BAD:
        if bad[0, 0] < 1e300:
            signal.receive(bad)
            assert node.counts[f"measurement: {kind}"] == 1
    signal.receive(np.array([[1e306, 1.0]]))
    assert node.counts["measurement: off the clock"] == 2
    signal.receive(row(10**6, 1.0))
    assert node.counts["measurement: far ahead"] == 1 and signal.rows.end == 1
    signal.receive(np.concatenate([row(1, 1.0), row(2, np.nan), row(3, 1.0)]))  # what is sound of it is used
    assert signal.rows.end == 4 and node.counts["measurement: missed ticks"] == 1
    signal.receive(row(3, 1.0))
    assert node.counts["measurement: duplicate"] == 1
    for tick in range(4, 4 + 2 * 65536, 65536):
        signal.receive(np.column_stack([np.arange(tick, tick + 65536) * PERIOD, np.zeros(65536)]))
    assert node.counts["measurement: too many waiting"] >= 1
    sender = bench.sender("measurement", "t[s],x[mrad]")
    sender.send(row(4, 1.0))
    bench.until(lambda: node.counts["measurement: wrong label"] == 1)
    sender.publisher.publish(cut_short())
    bench.until(lambda: node.counts["measurement: unreadable"] == 1)


def test_recorded_topic(bench, tmp_path):
    node = bench.add(Recorder, output=str(tmp_path / "bag"), topics=["command"], rate_hz=RATE)
    [topic] = node._topics
    topic.receive("t[s],x[V", row(0, 1.0))
    assert node.counts["/command: wrong label"] == 1
    topic.receive("t[s],x[V]", row(0, 1.0))
    topic.receive("t[s],x[V]", np.zeros((0, 2)))
    for moment in (np.nan, 1e306, 0.5 * PERIOD):
        topic.receive("t[s],x[V]", np.array([[moment, 1.0]]))
    assert node.counts["/command: off the clock"] == 4
    topic.receive("t[s],x[V]", row(10**6, 1.0))
    assert node.counts["/command: far ahead"] == 1
    topic.receive("t[s],x[V]", row(0, 1.0))
    assert node.counts["/command: duplicate"] == 1
    topic.receive("t[s],x[V]", row(1, np.nan))
    assert topic.recorded == 2  # a value that is none is evidence
    bench.sender("command", "t[s],x[V]").publisher.publish(cut_short())
    bench.until(lambda: node.counts["/command: unreadable"] == 1)
    node.close()


def test_rival_is_who_says_what_the_node_has_not(bench, monkeypatch):
    node = bench.add(PiFeedback, rate_hz=RATE)
    node.command.send(5, np.array([[3.0]]))
    rival = bench.sender("command", "t[s],x[V]")
    wrong = bench.sender("command", "t[s],x[mV]")
    bench.until(lambda: node._rivals.listening)
    bench.until(lambda: rival.publisher.get_subscription_count() > 0)
    for sender, message in (
        (wrong, row(6, 1.0)),
        (rival, row(6.5, 1.0)),
        (rival, row(6, np.nan)),
        (rival, row(5, 3.0)),
        (rival, row(9, 7.0)),
    ):
        sender.send(message)
    bench.until(lambda: node._rivals.newest is not None)
    assert node._rivals.newest.tolist() == [7.0] and node._rivals.silent_for < 10.0
    monkeypatch.setattr(rival_watch, "SENT_ROWS", 3)
    node._rivals.sent(np.column_stack([np.arange(9.0), np.zeros(9)]))
    assert len(node._rivals._sent) == 3
    for sender in (rival, wrong):
        bench.probe.destroy_publisher(sender.publisher)
    bench.until(lambda: not node._rivals.listening)


def test_takeover_hears_what_is_applied_and_nothing_else(bench):
    node = bench.add(PiFeedback, rate_hz=RATE)
    sender, wrong = bench.sender("applied", "t[s],x[V]"), bench.sender("applied", "t[s],x[um]")
    wrong.send(row(1, 1.0))
    sender.send(row(2, np.nan))
    assert not node._takeover.ready(100.0)
    bench.until(lambda: not node._takeover.ready(100.0) and node.counts["applied: not finite"] == 1)
    assert node._takeover.command is None
    sender.send(np.concatenate([row(7, 4.0), row(8, 5.0)]))
    bench.until(lambda: node._takeover.ready(100.0))
    assert node._takeover.tick == 8 and node._takeover.command.tolist() == [5.0]
    node._takeover._heard -= 10.0  # long ago
    assert not node._takeover.ready(100.0) and node._takeover.command is None
    node._takeover._since -= 200.0
    assert node._takeover.ready(100.0)
    node._takeover.forget()
    assert not node._takeover.ready(100.0) and node._takeover.ready(0.0)
