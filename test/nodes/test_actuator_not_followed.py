# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A feedback hears at once that the actuator does not follow, whichever of the two nodes has its tick first."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from hyst_control.nodes.loop.takeover import Takeover
from hyst_control.records.stream.row_repetition import SentRows
from hyst_control.records.stream.signal_message import label_for

PERIOD, CLOSE = 0.005, 0.05
COMMANDS = 40.0 + 0.2 * np.arange(50)  # V, tick by tick


def tracked(voltage, tick):
    """Voltage (V) that the feedback tracks after a message on `applied`; None where it takes the actuator to follow."""
    message = (label_for(("x",), "V"), np.array([[tick * PERIOD, voltage]]), None)
    node = SimpleNamespace(
        axes=("x",),
        period=PERIOD,
        timer=SimpleNamespace(longest_age=0.25),
        intake=lambda topic: SimpleNamespace(take=lambda drop: [message]),
        drop=lambda topic, kind: None,
    )
    sent = SentRows()
    for start, value in enumerate(COMMANDS):
        sent.add(start, np.array([[start * PERIOD, value]]))
    return Takeover(node).apart(sent, CLOSE)


@pytest.mark.parametrize("ahead", [-3, -1, 0, 1, 2])
def test_a_voltage_that_was_not_commanded_is_tracked_whichever_node_ticks_first(ahead):
    tick = len(COMMANDS) - 1 + ahead
    np.testing.assert_array_equal(tracked(1.0, tick), [1.0])
    newest = COMMANDS[min(tick, len(COMMANDS) - 1)]
    assert tracked(newest, tick) is None and tracked(newest - 0.2, tick) is None, "the command, or that of the tick before"
    assert tracked(newest + 1.0, tick) is not None


def test_a_voltage_is_not_compared_at_a_tick_long_after_the_last_command():
    assert tracked(1.0, len(COMMANDS) + 20) is None
