"""A node that waits in lockstep says in its diagnostics for which tick of which signal, and since when."""

from __future__ import annotations

import re

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from loop_case import MODEL
from std_msgs.msg import Int64

from hyst_control.nodes.feedforward import Feedforward
from hyst_control.nodes.pi_feedback import PiFeedback
from hyst_control.nodes.recorder import Recorder
from hyst_control.nodes.signal_node.message_io import QUEUE
from hyst_control.nodes.signal_node.node_diagnostics import REPORTED_WAIT, WAIT_WARNING, NodeHealth
from hyst_control.records.stream.signal_rows import Wait
from hyst_plant_sim.node import PlantNode

PERIOD = 1e-3


def rows(first, end, value=1.0):
    return np.column_stack([np.arange(first, end) * PERIOD, np.full(end - first, value)])


def waiting_for(bench, node):
    """What the node's newest diagnostics say that it waits for: [(signal, tick, s)]."""
    said = bench.said.get(f"/{node}: loop", {}).get("waiting_for", "none")
    found = re.findall(r"(\w+)@(\d+) \((\d+\.\d) s\)", said)
    return [(signal, int(tick), float(seconds)) for signal, tick, seconds in found]


def test_a_node_that_waits_names_signal_and_tick_and_warns_after_a_while(bench):
    """Reference rows end at tick 1234, feedforward and measurement go on."""
    node = bench.add(PiFeedback, rate_hz=1 / PERIOD, upper=50.0, frozen_time=0.0)
    bench.listen_to_diagnostics()
    labels = {"feedforward": "t[s],x[V]", "reference": "t[s],x[um]", "measurement": "t[s],x[um]"}
    senders = {topic: bench.sender(topic, label) for topic, label in labels.items()}
    for topic, end in (("reference", 1234), ("feedforward", 1300), ("measurement", 1240)):
        senders[topic].send(rows(0, end))
    bench.until(lambda: node.command.sent.end == 1234)
    bench.until(lambda: waiting_for(bench, "pi_feedback"))
    [(signal, tick, _)] = waiting_for(bench, "pi_feedback")
    assert (signal, tick) == ("reference", 1234)
    bench.until(lambda: bench.said["/pi_feedback: loop"]["level"] == DiagnosticStatus.WARN)
    said = bench.said["/pi_feedback: loop"]
    assert said["message"] == f"waiting for {said['waiting_for']}"
    assert waiting_for(bench, "pi_feedback")[0][2] >= WAIT_WARNING
    senders["reference"].send(rows(1234, 1300))
    senders["measurement"].send(rows(1240, 1241))
    bench.until(lambda: [wait[:2] for wait in waiting_for(bench, "pi_feedback")] == [("measurement", 1241)])
    assert bench.said["/pi_feedback: loop"]["level"] == DiagnosticStatus.OK  # it went on a moment ago


def test_a_plant_names_its_recorder_and_a_recorder_the_topic_that_is_behind(bench, tmp_path):
    recorder = bench.add(Recorder, output=str(tmp_path / "bag"), topics=["command", "measurement"], rate_hz=1 / PERIOD)
    plant = bench.add(PlantNode, model=MODEL, rate_hz=1 / PERIOD, wait_for_recorder=True)
    bench.listen_to_diagnostics()
    recorder._progress.publish = lambda message: None  # as if it did not hear the measurement
    command = bench.sender("command", "t[s],x[V]")
    command.send(rows(0, 100))
    bench.until(lambda: plant.command.rows.end == 100)
    bench.until(lambda: [wait[:2] for wait in waiting_for(bench, "plant")] == [("recorded", 0)])
    told = bench.probe.create_publisher(Int64, "recorded", QUEUE)
    bench.until(lambda: told.get_subscription_count() > 0)
    told.publish(Int64(data=0))
    bench.until(lambda: [wait[:2] for wait in waiting_for(bench, "plant")] == [("command", 100)])
    bench.until(lambda: [wait[:2] for wait in waiting_for(bench, "recorder")] == [("command", 100)])  # measurement 100 is there


def test_a_node_on_the_wall_clock_waits_for_nothing(bench):
    bench.add(lambda **options: Feedforward("feedforward", **options), schedule="timer", rate_hz=100.0)
    bench.listen_to_diagnostics()
    bench.until(lambda: "/feedforward: loop" in bench.said)
    assert bench.said["/feedforward: loop"]["waiting_for"] == "none"


def test_level_and_message_follow_from_the_state_of_the_node():
    short, reported, long = (Wait("reference", 7, seconds) for seconds in (0.5 * REPORTED_WAIT, REPORTED_WAIT, WAIT_WARNING))
    for health, waiting, warning in (
        (NodeHealth(), "none", ""),
        (NodeHealth(waits=[short]), "none", ""),
        (NodeHealth(waits=[reported]), f"reference@7 ({REPORTED_WAIT:.1f} s)", ""),
        (NodeHealth(waits=[short, long]), f"reference@7 ({WAIT_WARNING:.1f} s)", f"waiting for reference@7 ({WAIT_WARNING:.1f} s)"),
        (NodeHealth(stale=["reference"], waits=[long]), str(long), "stale: reference"),
        (NodeHealth(contested=["reference"]), "none", "several sources: reference"),
        (NodeHealth(trouble="frozen", stale=["reference"]), "none", "frozen"),
    ):
        assert (health.waiting_for, health.warning, health.warns) == (waiting, warning, bool(warning))
    assert NodeHealth(enabled=False).warns and not NodeHealth(enabled=False).warning
