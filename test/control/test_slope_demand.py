"""Slope that a reference asks for, against differences computed here."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hyst_control.control.feedback.slope_demand import SlopeDemand

ROWS = st.lists(st.tuples(st.floats(-9, 9), st.floats(-9, 9)), min_size=1, max_size=30)


@given(ROWS, st.integers(1, 7), st.floats(0.1, 9))
def test_the_first_step_beyond_the_limit_is_found_once_however_the_rows_come(rows, block, step):
    values = np.array(rows)
    steps = np.abs(np.diff(values, axis=0, prepend=np.zeros((1, 2)))).max(axis=1)
    demand = SlopeDemand(np.zeros(2))
    found = [demand.exceeds(first, values[first : first + block], step) for first in range(0, len(values), block)]
    beyond = np.flatnonzero(steps > step * (1 + 1e-9))
    expected = [] if not len(beyond) else [(beyond[0], steps[beyond[0]])]
    assert [each for each in found if each] == expected


def test_missed_ticks_are_time_too_and_rows_that_come_again_are_passed_by():
    demand = SlopeDemand()
    assert demand.exceeds(7, np.array([[50.0]]), 1.0) is None, "nothing is known before the first"
    assert demand.exceeds(17, np.array([[60.0]]), 1.0) is None
    assert demand.exceeds(17, np.array([[99.0]]), 1.0) is None
    assert demand.exceeds(19, np.array([[64.0]]), 0.0) is None, "no limit"
    assert demand.exceeds(19, np.array([[64.0]]), 1.0) == (19, 2.0)
