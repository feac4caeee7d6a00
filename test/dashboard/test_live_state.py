# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""State of a loop that a page shows: readers get every row once, and a loop that was started anew begins a new table."""

from __future__ import annotations

import numpy as np

from hyst_control.dashboard.live_state import LiveState, NodeState, Trace

COLUMNS = ("t[s]", "x[um]")


def rows(*times):
    return np.array([[time, 10.0 * time] for time in times])


def test_a_reader_gets_every_row_once():
    trace = Trace(10.0)
    trace.add(COLUMNS, rows(0.0, 0.1))
    epoch, index, first = trace.since(0, 0)
    trace.add(COLUMNS, rows(0.1, 0.2))  # 0.1 came before
    _, _, second = trace.since(epoch, index)
    np.testing.assert_array_equal(np.concatenate([first, second])[:, 0], [0.0, 0.1, 0.2])
    assert len(trace.since(*trace.since(0, 0)[:2])[2]) == 0


def test_only_the_window_is_kept():
    trace = Trace(1.0)
    for time in np.arange(0.0, 5.0, 0.1):
        trace.add(COLUMNS, rows(time))
    kept = trace.since(0, 0)[2][:, 0]
    assert kept[-1] - kept[0] <= 1.0 + 1e-9 and len(kept) >= 10


def test_a_time_that_goes_back_and_other_columns_begin_anew():
    trace = Trace(10.0)
    trace.add(COLUMNS, rows(5.0))
    epoch, index, _ = trace.since(0, 0)
    trace.add(COLUMNS, rows(1.0))
    again, index, found = trace.since(epoch, index)
    assert again > epoch and found[:, 0].tolist() == [1.0]
    trace.add(("t[s]", "y[um]"), rows(2.0))
    assert trace.since(again, index)[2][:, 0].tolist() == [2.0]


def test_nothing_is_old_before_the_first_row():
    trace = Trace(1.0)
    trace.add(COLUMNS, np.zeros((0, 2)))
    assert trace.age == np.inf and trace.since(0, 0)[2].shape == (0, 1)


def test_a_silent_node_is_lost():
    state = LiveState()
    state.set_node(NodeState("plant", False, "running"))
    assert state.nodes[0].lost
