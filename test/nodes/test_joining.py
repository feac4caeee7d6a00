"""Who is discovered in the middle of a burst of rows hears the later ones only: it waits until all are sent again."""

from __future__ import annotations

import signal
import threading
import time

import numpy as np
import pytest
from loop_case import recorded

from hyst_control.nodes.execution import interrupts
from hyst_control.nodes.feedforward import Feedforward
from hyst_control.nodes.pi_feedback import PiFeedback
from hyst_control.nodes.recorder import Recorder
from hyst_control.records.stream.signal_rows import LONGEST_JOINING

PERIOD = 1e-3


def rows(first, last):
    ticks = np.arange(first, last)
    return np.column_stack([ticks * PERIOD, ticks])


@pytest.fixture
def feedforward(bench):
    node = bench.add(lambda **options: Feedforward("feedforward", **options), rate_hz=1 / PERIOD, kind="proportional", gain=[10.0])
    sent = []
    node.feedforward.sender.send = lambda block: sent.extend(np.rint(block[:, 0] / PERIOD).astype(int))
    return node, sent


def receive(input_, block):
    input_.receive(input_.label, block)


def test_a_burst_heard_from_its_middle_on_is_taken_when_it_is_sent_again(feedforward):
    node, sent = feedforward
    for tick in range(17, 41):
        receive(node.reference, rows(tick, tick + 1))
    assert sent == []
    for first in range(0, 41, 20):
        receive(node.reference, rows(first, min(first + 20, 41)))
    assert sent == list(range(41))


def test_a_run_under_way_is_taken_up_where_its_repetition_begins(feedforward):
    node, sent = feedforward
    for first in (1000, 1064, 1000, 1064):
        receive(node.reference, rows(first, first + 64))
    assert sent == list(range(1000, 1128))


def test_a_run_that_goes_on_and_repeats_nothing_is_taken_up_after_a_while(feedforward, monkeypatch):
    node, sent = feedforward
    now = [100.0]
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    for tick in range(500, 5000):
        now[0] += PERIOD
        receive(node.reference, rows(tick, tick + 1))
    assert sent[-1] == 4999 and sent == list(range(sent[0], 5000))
    assert 500 + LONGEST_JOINING / PERIOD <= sent[0] <= 505 + LONGEST_JOINING / PERIOD


def test_after_a_reset_the_first_rows_are_waited_for_again(feedforward):
    node, sent = feedforward
    receive(node.reference, rows(0, 10))
    node._reset()
    receive(node.reference, rows(10, 20))
    assert sent == list(range(10))
    receive(node.reference, rows(9, 20))
    assert sent == [*range(10), *range(9, 20)]


def test_feedback_whose_inputs_begin_apart_starts_with_all_of_them(bench):
    """The loop stood still for ever: rows of the tick that the plant waits for were left behind."""
    node = bench.add(PiFeedback, rate_hz=1 / PERIOD, upper=50.0)
    receive(node.feedforward, rows(17, 41))
    receive(node.measurement, rows(0, 1))
    receive(node.reference, rows(0, 41))
    assert node.command.sent.end == 0
    receive(node.feedforward, rows(0, 41))
    assert node.command.sent.end == 1


@pytest.mark.parametrize("merge", [1, 8, 64])
def test_the_recorder_stores_what_was_sent_before_it_was_heard(bench, tmp_path, merge):
    node = bench.add(Recorder, output=str(tmp_path / "bag"), topics=["reference", "command"], rate_hz=1 / PERIOD, merge=merge)
    reference, command = node._topics
    told = []
    node._progress.publish = lambda message: told.append(message.data)
    command.receive("t[s],x[V]", rows(0, 1))
    for first, last in ((24, 32), (32, 41)):
        reference.receive("t[s],x[um]", rows(first, last))
    node._flush()
    node.progress()
    assert not told  # the plant waits: what was missed comes again
    for first, last in ((0, 16), (16, 32), (32, 41), (41, 50)):
        reference.receive("t[s],x[um]", rows(first, last))
    node.progress()
    assert told == [0]
    node.close()
    np.testing.assert_array_equal(recorded(tmp_path / "bag")["reference"], rows(0, 50))


def test_the_recorder_keeps_all_it_heard_of_a_run_that_it_joined_late(bench, tmp_path):
    node = bench.add(Recorder, output=str(tmp_path / "bag"), topics=["command"], rate_hz=1 / PERIOD)
    [command] = node._topics
    for first, last in ((700, 705), (705, 706), (708, 720)):  # 706 and 707 are lost: no burst that comes again
        command.receive("t[s],x[V]", rows(first, last))
    node.close()
    np.testing.assert_array_equal(recorded(tmp_path / "bag")["command"], np.concatenate([rows(700, 706), rows(708, 720)]))


def test_the_recorder_closed_before_it_knew_keeps_what_it_heard(bench, tmp_path):
    node = bench.add(Recorder, output=str(tmp_path / "bag"), topics=["command"], rate_hz=1 / PERIOD)
    node._topics[0].receive("t[s],x[V]", rows(700, 705))
    node.close()
    np.testing.assert_array_equal(recorded(tmp_path / "bag")["command"], rows(700, 705))


def test_an_interrupt_while_nodes_are_closed_changes_nothing(listening):
    before = signal.getsignal(signal.SIGINT)
    with interrupts.ignored():
        for _ in range(3):
            signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is before
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)
    threads = []

    def elsewhere():
        with interrupts.ignored():
            threads.append(threading.current_thread())

    thread = threading.Thread(target=elsewhere)
    thread.start()
    thread.join()
    assert threads == [thread]


def test_what_is_applied_is_recorded_after_a_long_silence_too(bench, tmp_path):
    """A stage follows its command for longer than rows may lie ahead, then its watchdog takes over; a time to come is refused."""
    node = bench.add(
        Recorder, output=str(tmp_path / "bag"), topics=["command"], schedule="timer", rate_hz=1 / PERIOD, most_waiting=50
    )
    [applied] = node._beside
    now = round(time.monotonic() / PERIOD)
    ticks = [now - 5000, now - 4995, now - 200, now - 195, now]
    for tick in ticks:
        applied.receive("t[s],x[V]", np.array([[tick * PERIOD, 1.0]]))
    applied.receive("t[s],x[V]", np.array([[(now + 10**6) * PERIOD, 1.0]]))
    assert node.counts["/applied: far ahead"] == 1 and node.counts["/applied: missed ticks"] == 0
    node.close()
    np.testing.assert_array_equal(np.rint(recorded(tmp_path / "bag")["applied"][:, 0] / PERIOD), ticks)
