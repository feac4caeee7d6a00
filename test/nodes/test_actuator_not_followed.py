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


def heard(voltage, tick):
    """What is heard of a voltage that was on the actuator at a tick, after the commands were sent."""
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
def test_voltage_that_was_not_commanded_is_heard_also_ahead_of_the_own_tick(ahead):
    tick = len(COMMANDS) - 1 + ahead
    np.testing.assert_array_equal(heard(1.0, tick), [1.0])
    newest = COMMANDS[min(tick, len(COMMANDS) - 1)]
    assert heard(newest, tick) is None and heard(newest - 0.2, tick) is None, "the command, or that of the tick before"
    assert heard(newest + 1.0, tick) is not None


def test_voltage_of_a_tick_of_which_no_command_is_known_says_nothing():
    assert heard(1.0, len(COMMANDS) + 20) is None
