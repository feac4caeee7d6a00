"""The one entry of foreign rows: what is admitted, and under which kind the rest is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hyst_control.records.stream import foreign_rows
from hyst_control.records.stream.foreign_rows import LARGEST_VALUE, Refusal, admissible, admit
from hyst_control.records.stream.signal_rows import MAX_TICK, Missing, Receipt, SignalRows

PERIOD = 1e-3


def block(*rows):
    return np.array(rows, dtype=float)


@pytest.mark.parametrize(
    "rows, kind",
    [
        ([(0.001, math.nan)], "not finite"),
        ([(math.nan, 1.0)], "not finite"),
        ([(0.001, math.inf)], "not finite"),
        ([(0.0, 1.0), (0.001, -math.inf)], "not finite"),
        ([(0.001, 1.7e308)], "out of range"),
        ([(0.001, -2 * LARGEST_VALUE)], "out of range"),
        ([(1e306, 1.0)], "out of range"),
        ([(1e300, 1.0), (1e300, 1.0)], "out of range"),
        ([(0.0014, 1.0)], "off the clock"),
        ([(-0.001, 1.0)], "off the clock"),
        ([(0.001, 1.0), (0.003, 1.0)], "off the clock"),
        ([(0.001, 1.0), (1e11, 1.0)], "off the clock"),
    ],
)
def test_what_is_refused_and_why(rows, kind):
    refusal = admit(block(*rows), PERIOD)
    assert isinstance(refusal, Refusal) and refusal.kind == kind and "\n" not in refusal.reason and len(refusal.reason) > 20


def test_ticks_end_where_a_double_counts_no_further():
    assert isinstance(admit(block((LARGEST_VALUE, 1.0)), 1e-6), Refusal)
    assert admit(block((1e11, 1.0)), 1e-3) == 10**14 < MAX_TICK


def test_a_message_of_more_rows_than_any_node_sends_is_refused(monkeypatch):
    monkeypatch.setattr(foreign_rows, "MAX_ROWS", 10)
    many = np.zeros((11, 2))
    many[:, 0] = np.arange(11) * PERIOD
    assert admit(many[:10], PERIOD) == 0
    assert admit(many, PERIOD).kind == "too long"


@given(st.lists(st.lists(st.floats(), min_size=2, max_size=2), min_size=1, max_size=4))
def test_whatever_comes_is_a_tick_or_a_refusal(rows):
    with np.errstate(all="ignore"):
        found = admit(block(*rows), PERIOD)
        if isinstance(found, Refusal):
            return
        assert 0 <= found <= MAX_TICK and np.abs(block(*rows)).max() <= LARGEST_VALUE
        np.testing.assert_allclose(block(*rows)[:, 0], (found + np.arange(len(rows))) * PERIOD, atol=1.1e-3 * PERIOD)


def test_rows_that_are_admissible():
    found = admissible(block((0.0, 1.0), (1.0, math.nan), (2.0, -math.inf), (3.0, 1e13), (4.0, -1e12)))
    assert found.tolist() == [True, False, False, False, True]


@pytest.mark.parametrize("missing", [Missing.SKIP, Missing.HOLD])
def test_a_single_row_far_ahead_is_refused_and_what_continues_it_is_taken(missing):
    rows = SignalRows(missing, 100, 0.0)
    assert rows.receive(0, np.zeros((1, 1)), 0.0) is Receipt.ACCEPTED
    assert rows.receive(10**6, np.ones((1, 1)), 0.0) is Receipt.AHEAD
    assert rows.receive(1, np.zeros((1, 1)), 0.0) is Receipt.ACCEPTED and rows.end == 2
    assert rows.receive(10**6, np.ones((2, 1)), 0.0) is Receipt.AHEAD
    assert rows.receive(10**6 + 2, np.ones((1, 1)), 0.0) is (Receipt.ACCEPTED if missing is Missing.SKIP else Receipt.HELD)


def test_ticks_that_the_newest_due_row_is_behind():
    rows = SignalRows(Missing.SKIP, 100, 0.0)
    assert rows.behind(50) == 0
    rows.receive(10, np.zeros((3, 1)), 0.0)
    assert rows.behind(11) == 0 == rows.behind(12) and rows.behind(20) == 8
    rows.receive(40, np.ones((1, 1)), 0.0)  # not due yet
    rows.newest(20)
    assert rows.behind(20) == 8
    rows.take(rows.available)
    assert rows.behind(45) == 5 and rows.behind(30) == 0


@pytest.mark.parametrize("value, kind", [(math.nan, "not finite"), (-math.inf, "not finite"), (-2 * LARGEST_VALUE, "out of range")])
@pytest.mark.parametrize("rows", [1, 2])
@pytest.mark.parametrize("axes", [3, 5000])
def test_one_bad_value_of_many_axes_is_enough(value, kind, rows, axes):
    block = np.ones((rows, 1 + axes))
    block[:, 0] = PERIOD * (7 + np.arange(rows))
    assert admit(block, PERIOD) == 7
    block[-1, axes // 2] = value
    found = admit(block, PERIOD)
    assert isinstance(found, Refusal) and found.kind == kind
