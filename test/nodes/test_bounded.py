# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Nothing that waits grows without end: rows nobody can use, two loops on one domain, a long run."""

from __future__ import annotations

import gc
import sys
import time
import tracemalloc

import numpy as np
import pytest
from loop_case import MODEL, RATE, parameters, recorded

from hyst_control.model_file import Simulator, load_model
from hyst_control.nodes import recorder
from hyst_control.nodes.diagnosis import DiagnosisNode
from hyst_control.nodes.feedforward import Feedforward
from hyst_control.nodes.pi_feedback import PiFeedback
from hyst_control.nodes.pipeline import DEFAULT, node_class
from hyst_control.nodes.recorder import Recorder
from hyst_control.nodes.reference_generator import ReferenceGenerator
from hyst_control.nodes.signal_node import lockstep, signal_ports
from hyst_control.nodes.signal_node.signal_ports import REPEATED_ROWS, Output
from hyst_control.records.stream.foreign_rows import LARGEST_VALUE
from hyst_control.records.stream.row_repetition import KEPT_ROWS, REPEAT_INTERVAL
from hyst_plant_sim.node import PlantNode

PERIOD = 1e-3
MOST = 250
LABELS = {"reference": "t[s],x[um]", "measurement": "t[s],x[um]", "feedforward": "t[s],x[V]", "command": "t[s],x[V]"}


def bring(signal, ticks, value=1.0):
    """One message of one row per tick, as the middleware would hand them over."""
    for tick in ticks:
        signal.receive(signal.label, np.array([[tick * PERIOD, value]]))


class Log:
    """Stands in for a node's logger."""

    def __init__(self):
        self.lines = []

    def warning(self, text):
        self.lines.append(text)

    def info(self, text):
        """States of the node are not what is tested."""


def test_inputs_of_a_loop_whose_reference_stands_still_stay_bounded(bench, monkeypatch):
    node, log = bench.add(PiFeedback, most_waiting=MOST, upper=50, start="first_command", takeover_time=0.0), Log()
    bench.listen_to_diagnostics()
    monkeypatch.setattr(node, "get_logger", lambda: log)
    monkeypatch.setattr(signal_ports, "LOG_INTERVAL", 1e9)
    for signal in (node.feedforward, node.measurement):
        bring(signal, range(20 * MOST))
        assert signal.rows.available == MOST == len(signal.rows._blocks)
        assert node.counts[f"{signal.topic}: too many waiting"] == 1
        assert node.counts[f"{signal.topic}: out of order"] == 19 * MOST - 1  # the ticks behind the one that was refused
    assert [line.split(":")[0] for line in log.lines] == ["feedforward"] * 2 + ["measurement"] * 2  # one line for each kind
    assert "most_waiting" in log.lines[0]
    bench.until(lambda: bench.said.get("/pi_feedback: loop", {}).get("measurement: too many waiting") == "1")
    bring(node.reference, range(MOST))  # it was only late: what waits is used, and there is room again
    assert [signal.rows.available for signal in node.inputs] == [0, 0, 0] and node.command.sent.end == MOST
    for signal in node.inputs:
        bring(signal, [MOST])
    assert node.command.sent.end == MOST + 1


def test_rows_ahead_of_the_clock_stay_bounded(bench):
    """A source whose clock is days ahead: on the wall clock its rows are never due, and refused unless `ahead` allows them."""
    node = bench.add(PlantNode, model=MODEL, schedule="timer", rate_hz=1000.0, most_waiting=MOST)
    node.timer.clocks.look_at(node.timer.now, node.settings.ahead)
    bring(node.command, range(10**9, 10**9 + 10 * MOST))
    assert node.command.rows.available == 0 and node.counts["command: far ahead"] == 10 * MOST
    node.timer.clocks.look_at(node.timer.now, 1e9)
    bring(node.command, range(10**9, 10**9 + 10 * MOST))
    assert (
        node.command.rows.available == MOST
        and node.counts["command: too many waiting"] + node.counts["command: far ahead"] == 19 * MOST
    )


MAKES = {
    "feedback": (PiFeedback, {"upper": 50.0}),
    "feedforward": (lambda **options: Feedforward("feedforward", **options), {"kind": "proportional", "gain": [10.0]}),
    "generator": (ReferenceGenerator, {"signal": "rest", "duration": 1.0, "lead": 8}),
    "plant": (PlantNode, {"model": MODEL}),
}


@pytest.mark.parametrize("name", MAKES)
def test_two_loops_on_one_domain_leave_memory_as_it_is(bench, name):
    """Ticks of two loops that are apart, most of them twice, early or late, with other values, mixed at random."""
    make, settings = MAKES[name]
    node, random = bench.add(make, rate_hz=1 / PERIOD, most_waiting=MOST, **settings), np.random.default_rng(1)

    def mix(first, last):
        for newest in range(first, last):
            for signal in node.inputs:
                for tick in (newest, newest, newest // 2, newest + int(random.integers(-20, 20)), 3 * newest):
                    bring(signal, [max(tick, 0)], float(random.integers(0, 3)))

    mix(0, 6 * MOST)
    bring(node.inputs[0], range(node.inputs[0].rows.end or 0, 2 * KEPT_ROWS))  # until what is kept to be repeated is full
    tracemalloc.start()
    try:
        before = tracemalloc.get_traced_memory()[0]
        mix(2 * KEPT_ROWS, 2 * KEPT_ROWS + 4 * MOST)
        gc.collect()
        grown = tracemalloc.get_traced_memory()[0] - before
    finally:
        tracemalloc.stop()
    assert all(len(signal.rows._blocks) <= signal.rows.available <= MOST for signal in node.inputs)
    kept = [port for port in vars(node).values() if isinstance(port, Output)]
    assert kept and all(port.sent.count <= KEPT_ROWS + settings.get("lead", 0) + 1 for port in kept)
    assert sum(node.counts.values()) > 10 * MOST
    assert grown < 600 * 4 * MOST  # bytes; a row that stays costs more than 200 of them, and each signal brought 10000 messages


class Clock:
    """Stands in for a module's `time`."""

    def __init__(self):
        self.now = time.monotonic()

    def monotonic(self):
        return self.now


@pytest.fixture
def repeating(bench, monkeypatch):
    """A feedforward node, the ticks that it repeats from, and its clock."""
    node = bench.add(MAKES["feedforward"][0], rate_hz=1 / PERIOD, kind="proportional", gain=[1.0])
    repeated = []
    node.repeat = lambda source, tick: repeated.append(tick)
    clock = Clock()
    monkeypatch.setattr(signal_ports, "time", clock)
    monkeypatch.setattr(lockstep, "time", clock)
    return node, repeated, clock


def test_repetitions_do_not_multiply_while_the_loop_goes_on(repeating):
    """Each tick comes twice, as from two loops: to repeat what is known would bring more of the same to both."""
    node, repeated, clock = repeating
    for tick in range(2000):
        clock.now += 0.9 * REPEAT_INTERVAL
        bring(node.reference, [tick, tick])
    assert node.counts["reference: duplicate"] == 2000 and not repeated
    clock.now += 1.1 * REPEAT_INTERVAL  # nothing new comes any more: now somebody may lack something
    bring(node.reference, [1999] * 100)
    assert repeated == [1999]
    begin = clock.now
    while clock.now < begin + 10.0:  # nobody can be helped: ever more rarely
        clock.now += 0.01
        bring(node.reference, [1999])
    assert 20 <= len(repeated) < 30
    repeated.clear()
    bring(node.reference, [2000])
    clock.now += 1.1 * REPEAT_INTERVAL
    bring(node.reference, [2000])
    assert repeated == [2000]


def test_a_repetition_begins_where_the_burst_began_that_caused_it(repeating):
    """Not at its last message, when the interval is over just then: who joins there would go on without the rows before."""
    node, repeated, clock = repeating
    bring(node.reference, range(200))
    for interval in (REPEAT_INTERVAL, 2 * REPEAT_INTERVAL, 4 * REPEAT_INTERVAL):
        clock.now += 0.9 * interval
        for tick in range(100, 200):
            bring(node.reference, [tick])
            clock.now += 0.002 * interval
    assert repeated == [100, 100, 100]


def test_what_is_repeated_is_what_may_be_lacking_in_messages_of_bounded_size(bench):
    """The middleware keeps room for the longest message in each of its 5000 places of a queue, for ever."""
    node = bench.add(MAKES["feedforward"][0], rate_hz=1 / PERIOD, kind="proportional", gain=[1.0])
    sent = []
    bring(node.reference, range(2 * KEPT_ROWS))
    node.feedforward.sender.send = lambda block: sent.append(np.rint(block[:, 0] / PERIOD).astype(int))
    for tick, expected in (
        (2 * KEPT_ROWS - 3, range(2 * KEPT_ROWS - 3, 2 * KEPT_ROWS)),
        (2 * KEPT_ROWS, [2 * KEPT_ROWS - 1]),
        (5, range(KEPT_ROWS, 2 * KEPT_ROWS)),
        (KEPT_ROWS + 10, range(KEPT_ROWS + 10, 2 * KEPT_ROWS)),
    ):
        sent.clear()
        node.repeat(node.reference, tick)
        np.testing.assert_array_equal(np.concatenate(sent), expected)
        assert max(map(len, sent)) <= REPEATED_ROWS


def test_a_diagnosis_whose_measurement_never_comes_stays_bounded(bench):
    node = bench.add(DiagnosisNode, model=MODEL, rate_hz=1 / PERIOD, most_waiting=MOST)
    for first in range(0, 20 * MOST, 50):
        node._command.receive(np.column_stack([np.arange(first, first + 50) * PERIOD, np.ones(50)]))
        node._drain()
    assert node._command.rows.available <= MOST + 50 and node.counts["command: too many waiting"] > 0
    node.enabled = False
    for first in range(0, 20 * MOST, 50):
        node._command.receive(np.column_stack([np.arange(first, first + 50) * PERIOD, np.ones(50)]))
        node._measurement.receive(np.column_stack([np.arange(first, first + 50) * PERIOD, np.ones(50)]))
        node._drain()
    assert node._command.rows.available == node._measurement.rows.available == 0


def test_the_recorder_beside_two_sources_stores_each_tick_once(bench, tmp_path, monkeypatch):
    """Rows of two sources, mixed in one queue: the pending ones go to the bag, what was told is not told without end."""
    clock = Clock()
    monkeypatch.setattr(recorder, "time", clock)
    node = bench.add(Recorder, output=str(tmp_path / "bag"), topics=["command"], rate_hz=1 / PERIOD, merge=64)
    [topic] = node._topics
    told = []
    node._progress.publish = told.append
    for tick in range(4000):
        clock.now += PERIOD
        for value in (1.0, 2.0):
            topic.receive(LABELS["command"], np.array([[tick * PERIOD, value]]))
        assert topic._pending_rows < 64
    assert node.counts["/command: duplicate"] == 4000 and len(told) <= 4.0 / REPEAT_INTERVAL + 4000 / recorder.PROGRESS_INTERVAL + 1
    node.close()
    rows = recorded(tmp_path / "bag")["command"]
    np.testing.assert_array_equal(rows, np.column_stack([np.arange(4000) * PERIOD, np.ones(4000)]))


class Counting:
    """A plant that counts the interpreter's memory blocks when it comes to these ticks."""

    def __init__(self, ticks):
        self._inner, self._ticks, self._tick, self.blocks = Simulator(load_model(MODEL), 1 / RATE), set(ticks), 0, []
        self.axes, self.units = self._inner.axes, self._inner.units

    def reset(self, command):
        return self._inner.reset(command)

    def step(self, commands):
        self._tick += len(commands)
        if self._tick in self._ticks:
            gc.collect()
            self.blocks.append(sys.getallocatedblocks())
        return self._inner.step(commands)


def test_the_loop_allocates_nothing_that_stays(bench, tmp_path):
    """Ten thousand rounds of the composed loop, once its outputs have kept as many rows as they keep.

    A row that stayed would be three blocks.
    """
    plant = Counting([6000, 16_000])
    settings = parameters(tmp_path, 17_000, plant={"wait_for_recorder": False, "model": ""})
    nodes = {}
    for name in DEFAULT:
        if name != "recorder":
            make = node_class(name) if name != "plant" else lambda **options: PlantNode(plant=plant, **options)
            nodes[name] = bench.add(make, **settings[name])
    bench.until(nodes["plant"].finished.done, timeout=60)
    before, after = plant.blocks
    assert after - before < 1000, f"{after - before} memory blocks more after 10000 rounds"


def test_a_feedforward_publishes_no_row_that_others_would_drop(bench, domain):
    """In lockstep they would wait for it for ever: a reference within the bounds may lead beyond them."""
    node = bench.add(lambda **options: Feedforward("feedforward", **options), gain=[8.0], schedule="lockstep")
    sent = []
    node.feedforward.send = lambda tick, rows: sent.append(rows.copy())
    bring(node.reference, range(1), 9.9e11)
    bring(node.reference, range(1, 2), -9.9e11)
    bring(node.reference, range(2, 3), 5.0)
    for _ in range(3):
        node.advance()
    assert np.concatenate(sent).ravel().tolist() == [LARGEST_VALUE, -LARGEST_VALUE, 40.0]
