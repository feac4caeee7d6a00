# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The live view: peaks of signals, values of one tick side by side, and a loop without a reference."""

from __future__ import annotations

import numpy as np
import pytest

from hyst_control.nodes.live_view import LiveView

RATE = 1000.0


@pytest.fixture
def signals():
    """Three signals of 2 s with a spike of one tick in each."""
    time = np.arange(2000) / RATE
    found = {"reference": np.sin(2 * np.pi * 5 * time), "command": 20 + np.cos(2 * np.pi * 5 * time), "measurement": 0.9 * time}
    for index, values in enumerate(found.values()):
        values[321 + 400 * index] += 50.0
    return time, found


@pytest.mark.parametrize("schedule", ["timer", "lockstep"])
def test_spikes_pass_and_rows_stay_together(bench, signals, schedule):
    time, values = signals
    bench.listen("live", "live_turn")
    node = bench.add(LiveView, rate_hz=RATE, schedule=schedule)
    units = {"reference": "um", "command": "V", "measurement": "um"}
    senders = {topic: bench.sender(topic, f"t[s],x[{unit}]") for topic, unit in units.items()}
    bench.until(lambda: node._live.publisher.get_subscription_count() and node._turn.publisher.get_subscription_count())
    for begin in range(0, len(time), 100):
        for topic, sender in senders.items():
            sender.send(np.column_stack([time, values[topic]])[begin : begin + 100])
    bench.until(lambda: len(bench.rows("live")) and bench.rows("live")[-1, 0] > 1.94)
    live = bench.rows("live")
    ticks = np.rint(live[:, 0] * RATE).astype(int)
    assert len(live) <= 2000 / 50 * 8
    for column, topic in enumerate(units):
        np.testing.assert_array_equal(live[:, 1 + column], values[topic][ticks])
        assert live[:, 1 + column].max() == values[topic].max()
    np.testing.assert_array_equal(live[:, 4], live[:, 1] - live[:, 3])
    assert len(bench.rows("live_turn")) and bench.rows("live_turn").shape[1] == 3


def test_open_loop_has_no_reference(bench, signals):
    time, values = signals
    bench.listen("live")
    node = bench.add(LiveView, rate_hz=RATE)
    senders = {topic: bench.sender(topic, f"t[s],x[{unit}]") for topic, unit in (("command", "V"), ("measurement", "um"))}
    bench.until(lambda: node._live.publisher.get_subscription_count())
    for topic, sender in senders.items():
        sender.send(np.column_stack([time, values[topic]]))
    bench.until(lambda: len(bench.rows("live")))
    live = bench.rows("live")
    assert np.isnan(live[:, [1, 4]]).all() and np.isfinite(live[:, [0, 2, 3]]).all()


def test_a_loop_that_begins_anew_is_shown_anew(bench):
    bench.listen("live")
    node = bench.add(LiveView, rate_hz=RATE, bin=0.001)
    senders = [bench.sender("command", "t[s],x[V]"), bench.sender("measurement", "t[s],x[um]")]
    bench.until(lambda: node._live.publisher.get_subscription_count())
    for start in (5.0, 1.0):
        for sender in senders:
            sender.send(np.column_stack([start + np.arange(20) / RATE, np.ones(20)]))
        bench.until(lambda start=start: len(bench.rows("live")) and abs(bench.rows("live")[-1, 0] - start) < 0.1)


def test_the_error_is_told_over_every_tick(bench, signals):
    """Rms and peak are those of all rows, not of the published extremes."""
    time, values = signals
    node = bench.add(LiveView, rate_hz=RATE)
    units = {"reference": "um", "command": "V", "measurement": "um"}
    senders = {topic: bench.sender(topic, f"t[s],x[{unit}]") for topic, unit in units.items()}
    bench.until(lambda: all(each.publisher.get_subscription_count() for each in senders.values()))
    node._errors.take()
    node.status = dict  # the diagnostics take the figures as well: here the test does
    for topic, sender in senders.items():
        sender.send(np.column_stack([time, values[topic]]))
    bench.until(lambda: node._seen == len(time))
    error = values["reference"] - values["measurement"]
    told = node._error_figures()
    assert float(told["rms error x [um]"]) == pytest.approx(np.sqrt(np.mean(error**2)), rel=1e-3)
    assert float(told["peak error x [um]"]) == pytest.approx(np.abs(error).max(), rel=1e-3)
    assert node._error_figures() == {}
