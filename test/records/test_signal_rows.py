# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The state machine of a signal's rows: whatever becomes of the messages, the same rows come out, or it is told what is waited for.

Every row's value is a function of its tick, so that a row that comes out can be judged by itself.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyst_control.records.stream.row_repetition import (
    KEPT_BLOCKS,
    KEPT_ROWS,
    LONGEST_INTERVAL,
    REPEAT_INTERVAL,
    RepetitionBackoff,
    SentRows,
    Standstill,
)
from hyst_control.records.stream.signal_rows import (
    GAP_PATIENCE,
    LONGEST_JOINING,
    MAX_GAPS,
    Missing,
    Receipt,
    SignalRows,
    Wait,
    first_tick,
    successive_parts,
    waits,
)

LENGTH = 40  # ticks of a run
PLENTY = 10_000  # rows
PERIOD = 5e-5  # s

block = st.tuples(st.integers(0, LENGTH - 1), st.integers(1, 12)).map(lambda pair: (pair[0], min(sum(pair), LENGTH)))
"""First tick of a message and the one behind its last: any part of the run, cut anywhere."""
messages = st.lists(block, max_size=60)
"""In any order, any of them several times, others never."""


def rows(first, end):
    """Rows (N, 2) of a run, values that are functions of the tick."""
    ticks = np.arange(first, end)
    return np.column_stack([ticks**2 + 0.5, -ticks])


def ticks_in(sent):
    """All ticks of these messages."""
    return {tick for first, end in sent for tick in range(first, end)}


def ticks_of(taken):
    """Ticks of rows that came out; their values must be those of these ticks."""
    ticks = -taken[:, 1].astype(int)
    np.testing.assert_array_equal(taken, rows(0, LENGTH)[ticks])
    return ticks.tolist()


def take_all(state):
    """Ticks of all rows that can be taken, each block's tick checked."""
    found = []
    for tick, taken in state.take_blocks():
        assert ticks_of(taken) == list(range(tick, tick + len(taken)))
        found += ticks_of(taken)
    return found


@settings(deadline=None)
@given(messages, st.data())
def test_refused_rows_come_again_and_every_tick_comes_out_once_and_in_order(sent, data):
    """Lockstep: after any messages, what came out is the run up to the tick that is waited for; a repetition of all gives the rest."""
    state, found, now = SignalRows(Missing.REFUSE, PLENTY, 0.0), [], 0.0
    for first, end in sent:
        now += 1e-3
        receipt = state.receive(first, rows(first, end), now)
        assert receipt in (Receipt.ACCEPTED, Receipt.DUPLICATE, Receipt.GAP, Receipt.JOINING)
        if state.available and data.draw(st.booleans()):
            found += ticks_of(state.take(data.draw(st.integers(1, state.available))))
    found += ticks_of(state.take(state.available)) if state.available else []
    begin = found[0] if found else 0
    assert found == list(range(begin, begin + len(found)))
    [wait] = waits({"reference": state}, now)
    assert wait.tick == (found[-1] + 1 if found else 0)
    for tick in range(begin, LENGTH):
        state.receive(tick, rows(tick, tick + 1), now)
    rest = ticks_of(state.take(state.available)) if state.available else []
    assert found + rest == list(range(begin, LENGTH))
    assert waits({"reference": state}, now)[0].tick == LENGTH


@settings(deadline=None)
@given(messages)
def test_a_run_that_is_heard_from_its_first_row_begins_with_it(sent):
    state = SignalRows(Missing.REFUSE, PLENTY, 0.0)
    for first, end in [(0, 1), *sent]:
        state.receive(first, rows(first, end), 0.0)
    came = ticks_in([(0, 1), *sent])
    found = ticks_of(state.take(state.available))
    assert found == list(range(len(found))) and set(found) <= came


@settings(deadline=None)
@given(messages)
def test_held_rows_lose_nothing_that_came(sent):
    """The recorder: every tick that came after all comes out once, in order; those that never came are counted."""
    state, found = SignalRows(Missing.HOLD, PLENTY, 0.0), []
    for first, end in sent:
        assert state.receive(first, rows(first, end), 0.0) in (Receipt.ACCEPTED, Receipt.HELD, Receipt.DUPLICATE, Receipt.LATE)
        state.release(0.0)
        found += take_all(state)
    complete = list(found)
    assert complete == list(range(complete[0], complete[0] + len(complete)) if complete else [])
    if state.joined:
        assert state.awaited == complete[-1] + 1
    state.release(0.0, give_up=True)
    found += take_all(state)
    came = ticks_in(sent)
    assert found == sorted(set(found)) and set(found) <= came
    assert found == sorted(tick for tick in came if not found or tick >= found[0])
    if complete:
        assert state.missed == found[-1] + 1 - len(found)
        assert sum(end - first for first, end in state.gaps) == state.missed
    assert not state.held and not state.available


@settings(deadline=None)
@given(messages)
def test_skipped_rows_are_lost_and_time_goes_on(sent):
    """The wall clock: ticks only increase, and those left out are counted."""
    state = SignalRows(Missing.SKIP, PLENTY, 0.0)
    for first, end in sent:
        state.receive(first, rows(first, end), 0.0)
    ticks, taken = state.take_before(LENGTH)
    assert ticks.tolist() == (ticks_of(taken) if len(taken) else [])
    assert np.all(np.diff(ticks) > 0)
    if sent:
        assert ticks[0] == sent[0][0] and ticks[-1] == max(end for _, end in sent) - 1
        assert state.missed == ticks[-1] + 1 - ticks[0] - len(ticks)


@settings(deadline=None)
@given(messages, messages, st.sampled_from(Missing))
def test_a_run_that_is_forgotten_leaves_no_trace_in_the_next_one(before, after, missing):
    """Restart: the same as a receiver that never heard the run before."""
    restarted, fresh = (SignalRows(missing, PLENTY, 0.0) for _ in range(2))
    for first, end in before:
        restarted.receive(first, rows(first, end) + 100.0, 0.0)
    restarted.forget()
    for first, end in after:
        assert restarted.receive(first, rows(first, end), 0.0) is fresh.receive(first, rows(first, end), 0.0)
    for state in (restarted, fresh):
        state.release(0.0, give_up=True)
    assert take_all(restarted) == take_all(fresh)
    assert restarted.end == fresh.end and list(restarted.gaps) == list(fresh.gaps)


@settings(deadline=None)
@given(messages, st.sampled_from(Missing), st.booleans(), st.integers(1, 20))
def test_what_waits_is_bounded(sent, missing, drop_oldest, most):
    """Nobody takes anything; a message may go beyond the limit, no second one."""
    state, longest = SignalRows(missing, most, 0.0, drop_oldest=drop_oldest), max((end - first for first, end in sent), default=0)
    for _ in range(3):
        for first, end in sent:
            state.receive(first, rows(first, end), 0.0)
            state.release(0.0)
            assert state.held <= most
            if missing is not Missing.HOLD:
                assert state.available < most + longest
    assert len(state.gaps) <= MAX_GAPS


@settings(deadline=None)
@given(messages)
def test_refused_for_want_of_room_is_not_lost(sent):
    """A queue of three rows: what was refused comes again, in order."""
    state, found = SignalRows(Missing.REFUSE, 3, 0.0), []
    state.expect(0)
    for first, end in [*sent, *((tick, tick + 1) for tick in range(LENGTH))]:
        while state.receive(first, rows(first, end), 0.0) is Receipt.FULL:
            found += ticks_of(state.take(1))
    found += ticks_of(state.take(state.available)) if state.available else []
    assert found == list(range(LENGTH))


@settings(deadline=None)
@given(st.lists(st.booleans(), min_size=1, max_size=400), st.integers(1, 5))
def test_a_loop_of_two_heals_whatever_is_lost(arrives, block_rows):
    """A source and a node that answers it: each repeats when it has reason to, and both have every row in the end.

    The loop is the lockstep protocol: the source sends row k + 1 once it has the answer to row k, repeats its newest message when it
    stands still, then all that it keeps; the answering node repeats what followed from rows that come again.
    """
    arrival = iter(arrives)
    clock, source_sent, answer_sent, standstill = [0.0], SentRows(), SentRows(), Standstill()
    heard, answered = (SignalRows(Missing.REFUSE, PLENTY, 0.0) for _ in range(2))
    answered.expect(0)
    got, answers = [], []

    def message(first, end):
        return np.column_stack([np.arange(first, end), rows(first, end)])

    def deliver(part, to):
        if next(arrival, True):
            to(int(part[0, 0]), part[:, 1:])

    def answer(tick, values):
        receipt = heard.receive(tick, values, clock[0])
        if receipt in (Receipt.DUPLICATE, Receipt.CONFLICT):
            assert receipt is Receipt.DUPLICATE
            oldest = heard.repetition_due(clock[0])
            if oldest is not None:
                again = answer_sent.since(oldest)
                again = answer_sent.newest if again is None else again
                if again is not None:
                    deliver(again, lambda first, values: answered.receive(first, values, clock[0]))
        elif heard.available:
            first = heard.start
            taken = ticks_of(heard.take(heard.available))
            got.extend(taken)
            part = message(first, first + len(taken))
            answer_sent.add(first, part)
            deliver(part, lambda first, values: answered.receive(first, values, clock[0]))

    end = 0
    rounds = len(arrives) + 400
    while len(answers) < LENGTH and rounds:
        rounds -= 1
        clock[0] += 0.6
        if answered.available:
            answers.extend(ticks_of(answered.take(answered.available)))
        if len(answers) == end and end < LENGTH:
            first, end = end, min(end + block_rows, LENGTH)
            source_sent.add(first, message(first, end))
            deliver(source_sent.newest, answer)
            standstill.look(None)
        else:
            looks = standstill.look((answered.end, end))
            if looks:
                deliver(source_sent.newest if looks == 1 else source_sent.since(0), answer)
    assert got == list(range(LENGTH))
    assert answers == list(range(LENGTH))


def test_rows_before_the_first_ones_heard_are_waited_for_no_longer_than_that():
    state = SignalRows(Missing.REFUSE, PLENTY, 0.0)
    assert state.receive(7, rows(7, 9), 1.0) is Receipt.JOINING
    assert state.receive(9, rows(9, 10), 1.0 + LONGEST_JOINING) is Receipt.JOINING
    assert waits({"command": state}, 2.0) == [Wait("command", 0, 2.0)]
    assert state.receive(10, rows(10, 11), 1.001 + LONGEST_JOINING) is Receipt.ACCEPTED
    assert state.start == 10


def test_first_rows_are_lost_once_none_has_come_before_them_for_long_enough():
    """The end of a run that is shorter than this: no further row comes, by which it could be known."""
    state = SignalRows(Missing.HOLD, PLENTY, 0.0)
    state.receive(1, rows(1, 4), 1.0)
    state.release(1.0 + LONGEST_JOINING)
    assert not state.joined and take_all(state) == []
    state.release(1.001 + LONGEST_JOINING)
    assert take_all(state) == [1, 2, 3] and state.awaited == 4
    assert state.missed == 1 and list(state.gaps) == [(0, 1)]
    assert state.receive(0, rows(0, 1), 9.0) is Receipt.LATE


def test_a_gap_is_given_up_after_its_patience():
    state = SignalRows(Missing.HOLD, PLENTY, 0.0)
    state.receive(0, rows(0, 2), 0.0)
    assert state.receive(4, rows(4, 5), 3.0) is Receipt.HELD
    state.release(3.0 + GAP_PATIENCE)
    assert state.end == 2 and waits({"command": state}, 8.0) == []  # its rows are there to be taken
    take_all(state)
    assert waits({"command": state}, 8.0) == [Wait("command", 2, 8.0)]
    state.release(3.1 + GAP_PATIENCE)
    assert state.end == 5 and state.missed == 2 and list(state.gaps) == [(2, 4)]
    assert state.receive(3, rows(3, 4), 9.0) is Receipt.LATE


def test_other_values_of_a_tick_are_a_conflict():
    state = SignalRows(Missing.SKIP, PLENTY, 0.0)
    state.receive(3, rows(3, 6), 0.0)
    assert state.receive(4, rows(4, 6), 1.0) is Receipt.DUPLICATE and state.conflicted == -np.inf
    assert state.receive(4, rows(4, 6) + 1.0, 2.0) is Receipt.CONFLICT and state.conflicted == 2.0


@pytest.mark.parametrize("threshold, receipt", [(4.0, Receipt.CLOCK_RESET), (4.1, Receipt.DUPLICATE)])
def test_rows_that_go_back_in_time_by_the_threshold_are_of_another_time(threshold, receipt):
    state = SignalRows(Missing.SKIP, PLENTY, 0.0, period=0.5, clock_reset_threshold=lambda: threshold)
    state.receive(10, rows(10, 12), 0.0)
    assert state.receive(3, rows(3, 4), 0.0) is receipt  # 8 ticks, 4 s


def test_the_oldest_rows_make_room_where_the_newest_count():
    state = SignalRows(Missing.SKIP, 5, 0.0, drop_oldest=True)
    for first in range(0, 20, 2):
        state.receive(first, rows(first, first + 2), 0.0)
    assert take_all(state) == list(range(14, 20)) and state.dropped == 14


def test_newest_row_of_a_tick_and_rows_skipped():
    state = SignalRows(Missing.SKIP, PLENTY, 0.0)
    for first, end in ((0, 3), (5, 8)):
        state.receive(first, rows(first, end), 0.0)
    np.testing.assert_array_equal(state.newest(4), rows(2, 3)[0])
    np.testing.assert_array_equal(state.newest(6), rows(6, 7)[0])
    assert state.available == 3
    state.skip_to(7)
    assert take_all(state) == [7]


def test_who_is_furthest_behind_is_waited_for():
    """A row that waits is not waited for; of those without one, the signal that holds the others up is named."""
    signals = {name: SignalRows(Missing.REFUSE, PLENTY, 10.0) for name in ("feedforward", "reference", "measurement")}
    assert [str(wait) for wait in waits(signals, 10.5)] == ["feedforward@0 (0.5 s)", "reference@0 (0.5 s)", "measurement@0 (0.5 s)"]
    for tick in range(20):
        signals["measurement"].receive(tick, rows(tick, tick + 1), 11.0)
        signals["feedforward"].receive(tick, rows(tick, tick + 1), 11.0)
    for tick in range(5):
        signals["reference"].receive(tick, rows(tick, tick + 1), 12.0)
    assert waits(signals, 12.0) == []
    for each in signals.values():
        each.take(5)
    assert [str(wait) for wait in waits(signals, 15.2)] == ["reference@5 (3.2 s)"]
    signals["measurement"].take(15)
    assert [str(wait) for wait in waits(signals, 15.2)] == ["reference@5 (3.2 s)"]


@settings(deadline=None)
@given(messages, st.integers(0, 10**7))
def test_blocks_of_several_messages_are_split_where_time_is_not_successive(sent, offset):
    joined = [tick for first, end in sent for tick in range(first, end)]
    if not joined:
        assert successive_parts(np.zeros((0, 2)), PERIOD) == []
        return
    merged = np.column_stack([(np.array(joined) + offset) * PERIOD, joined])
    parts = successive_parts(merged, PERIOD)
    assert [tick + k for tick, part in parts for k in range(len(part))] == [tick + offset for tick in joined]
    np.testing.assert_array_equal(np.concatenate([part for _, part in parts]), merged)
    assert all(right != left + len(part) for (left, part), (right, _) in zip(parts, parts[1:]))


@pytest.mark.parametrize("time", [np.nan, np.inf, -np.inf, -PERIOD, 0.4 * PERIOD])
def test_times_that_are_no_ticks_are_none(time):
    assert first_tick(np.array([[time, 1.0]]), PERIOD) is None
    assert [tick for tick, _ in successive_parts(np.array([[0.0, 1.0], [time, 1.0], [2 * PERIOD, 1.0]]), PERIOD)] == [0, None, 2]
    assert first_tick(np.array([[0.0, 1.0], [time, 1.0]]), PERIOD) is None


@settings(deadline=None)
@given(st.lists(st.integers(1, 700), min_size=1, max_size=60))
def test_what_was_sent_is_kept_as_long_as_it_may_be_lacking(lengths):
    sent, tick = SentRows(), 0
    for length in lengths:
        sent.add(tick, np.arange(tick, tick + length)[:, None])
        tick += length
        assert sent.count >= min(tick, KEPT_ROWS) and len(sent._blocks) >= min(len(lengths), 1)
        assert sent.count <= KEPT_ROWS + 700 * KEPT_BLOCKS
        assert sent.since(0).ravel().tolist() == list(range(tick - sent.count, tick))
        assert sent.since(tick - 1).ravel().tolist() == [tick - 1]
        assert sent.since(tick) is None and sent.newest[-1, 0] == tick - 1
    sent.add(tick + 5, np.array([[tick + 5]]))
    assert sent.since(0).tolist() == [[tick + 5]]


def test_repetitions_become_rare_and_progress_makes_them_quick_again():
    backoff, times, now = RepetitionBackoff(0.0), [], 0.0
    while now < 5.0:
        now += 1e-3
        if backoff.due(now):
            times.append(now)
    np.testing.assert_allclose(np.diff(times)[:4], REPEAT_INTERVAL * 2.0 ** np.arange(1, 5), atol=2e-3)
    np.testing.assert_allclose(np.diff(times)[5:], LONGEST_INTERVAL, atol=2e-3)
    backoff.progress(now)
    assert not backoff.due(now + 0.9 * REPEAT_INTERVAL) and backoff.due(now + 1.1 * REPEAT_INTERVAL)


def test_second_measurement_of_a_tick_replaces_the_first_and_one_in_every_tick_is_a_second_source():
    rows = SignalRows(Missing.SKIP, 100, 0.0, replace=True)
    for tick in range(3):
        assert rows.receive(tick, np.full((1, 1), 1.0), 0.0) is Receipt.ACCEPTED
    assert rows.receive(2, np.full((1, 1), 5.0), 0.0) is Receipt.REPLACED
    assert rows.newest(2).tolist() == [5.0] and rows.newest(9).tolist() == [5.0] and rows.conflicted == -np.inf
    found = []
    for tick in range(3, 8):
        rows.receive(tick, np.full((1, 1), 1.0), 1.0)
        found.append(rows.receive(tick, np.full((1, 1), float(tick)), 1.0))
    assert found == [Receipt.REPLACED] + [Receipt.CONFLICT] * 4 and rows.conflicted == 1.0
    rows.receive(8, np.full((1, 1), 1.0), 2.0)
    rows.receive(9, np.full((1, 1), 1.0), 2.0)
    assert rows.receive(9, np.full((1, 1), 2.0), 2.0) is Receipt.REPLACED
