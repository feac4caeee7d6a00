# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The actuator's side of a command, driven with anything: what is to be written is finite, in range, and follows on what was written."""

from __future__ import annotations

import math
import time
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyst_control.base.errors import InputError
from hyst_control.control.feedback.command_limits import CommandLimits
from hyst_control.control.feedback.command_watchdog import CommandWatchdog
from hyst_control.nodes.loop.actuator import Actuator
from hyst_control.records.stream.signal_rows import Missing, SignalRows

PERIOD, LOWER, UPPER, RATE, AGE = 0.01, 0.1, 20.0, 100.0, 0.05


class Stub:
    """What an actuator needs of its node."""

    def __init__(self, axes=2, safe=(LOWER,)):
        self.settings = SimpleNamespace(safe_command=safe, safe_rate=RATE)
        self.axes, self.period, self.timer = ("x", "y")[:axes], PERIOD, SimpleNamespace(longest_age=AGE, now=0.0)
        self.sent, self.warned = [], []

    def get_name(self):
        return "stub"

    def input(self, topic, unit):
        return SimpleNamespace(rows=SignalRows(Missing.SKIP, 100, 0.0, PERIOD))

    def output(self, topic, unit):
        return SimpleNamespace(send=lambda tick, rows: self.sent.append((tick, rows[0].tolist())))

    def warn(self, key, text):
        self.warned.append(key)


def made(step=math.inf, rest=LOWER, **node):
    stub = Stub(**node)
    actuator = Actuator(stub, CommandLimits(LOWER, UPPER, step))
    actuator.start_from(np.full(len(stub.axes), rest))
    wanted = actuator.wanted

    def in_time(tick, allowed=True):
        stub.timer.now = tick * PERIOD
        return wanted(tick, allowed)

    actuator.wanted = in_time
    return actuator, stub


VALUE = st.one_of(st.floats(-30, 30), st.sampled_from([LOWER, UPPER, 1e12, -1e12, 1.7e308, math.nan, math.inf, 0.3, 5e-324]))
TICK = st.tuples(st.one_of(st.none(), st.tuples(VALUE, VALUE)), st.booleans(), st.booleans())


@settings(max_examples=300, deadline=None)
@given(st.lists(TICK, max_size=60), st.sampled_from([math.inf, 0.7, 3.0]), st.floats(LOWER, UPPER), st.floats(LOWER, UPPER))
def test_what_is_to_be_written_is_finite_in_range_and_follows_on_what_was_written(ticks, step, rest, safe):
    actuator, _ = made(step, rest, safe=(safe,))
    last, failed, before = np.full(2, rest), False, None
    for tick, (command, allowed, works) in enumerate(ticks):
        if command is not None:
            actuator.command.rows.receive(tick, np.array([command]), 0.0)
        voltage = actuator.wanted(tick, allowed)
        assert np.isfinite(voltage).all() and voltage.min() >= LOWER and voltage.max() <= UPPER
        assert np.abs(voltage - last).max() <= step * (1 + 1e-9)
        if failed or not allowed or before is None:  # no command was followed
            assert np.abs(voltage - last).max() <= RATE * PERIOD * (1 + 1e-9)
        if works:
            actuator.watchdog.written(voltage)
            last = voltage
        failed, before = not works, voltage
        np.testing.assert_array_equal(actuator.watchdog.applied, last)
        assert works or not actuator.watchdog.armed or not actuator.watchdog.following


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(st.floats(LOWER, UPPER), st.booleans()), max_size=80))
def test_a_command_that_stays_is_reached_whatever_was_before(ticks):
    actuator, _ = made(1.5)
    for tick, (value, works) in enumerate([*ticks, *[(7.0, True)] * 30]):
        actuator.command.rows.receive(tick, np.array([[value, UPPER - value]]), 0.0)
        voltage = actuator.wanted(tick)
        if works:
            actuator.watchdog.written(voltage)
    assert voltage.tolist() == [7.0, UPPER - 7.0] and actuator.watchdog.following and not actuator.trouble()


def test_it_tells_what_was_written_while_that_is_not_the_command():
    actuator, stub = made(axes=1)
    actuator.report(0)
    assert actuator.safe and not stub.sent  # said at intervals
    for tick in range(1, 30):
        actuator.command.rows.receive(tick, np.array([[5.0]]), 0.0)
        actuator.voltage(tick)
        actuator.report(tick)
    assert actuator.watchdog.following and stub.sent[-1] == (4, [pytest.approx(LOWER + 4.0)]) and not stub.warned
    assert not actuator.safe and actuator.status() == {"applied [V]": "5"}
    actuator.command.rows.receive(30, np.array([[25.0]]), 0.0)
    actuator.wanted(30)  # fails to be written
    actuator.report(30)
    assert stub.sent[-1] == (30, [5.0]) and actuator.trouble().startswith("no trusted command")
    assert actuator.status() == {"applied [V]": "5", "limited ticks": 1}
    for tick in range(31, 50):
        actuator.voltage(tick)
        actuator.report(tick)
    assert set(stub.warned) == {"stale"} and actuator.safe and stub.sent[-1] == (49, [LOWER])


def test_two_sources_take_it_to_its_safe_value():
    actuator, stub = made(axes=1)
    for value in (5.0, 6.0):
        actuator.command.rows.receive(1, np.array([[value]]), 0.0)
    actuator.command.rows.conflicted = time.monotonic()
    assert actuator.voltage(1)[0] == LOWER
    actuator.report(1)
    assert stub.warned == ["contradicted"]


@pytest.mark.parametrize("step", [math.inf, 3.0])
def test_behind_a_stop_of_the_process_the_command_is_approached(step):
    actuator, stub = made(step, axes=1)
    for tick in range(20):
        actuator.command.rows.receive(tick, np.array([[5.0]]), 0.0)
        actuator.voltage(tick)
    assert actuator.watchdog.following
    voltages = [5.0]
    for tick in range(40, 60):  # what was missed is older than `AGE`; the feedback went to another voltage meanwhile
        actuator.command.rows.receive(tick, np.array([[15.0]]), 0.0)
        voltages += actuator.voltage(tick).tolist()
    assert np.abs(np.diff(voltages)).max() <= RATE * PERIOD * (1 + 1e-9)
    assert voltages[-1] == 15.0 and actuator.watchdog.following and stub.warned == ["stood still"]


def test_a_stop_before_the_first_command_changes_nothing():
    actuator, stub = made(axes=1)
    assert actuator.voltage(0).tolist() == actuator.voltage(40).tolist() == [LOWER]
    assert not stub.warned and not actuator.watchdog.armed


@pytest.mark.parametrize("late", range(2, 5))
def test_a_short_stop_is_within_what_a_command_may_be_old(late):
    actuator, stub = made(axes=1)
    for tick in [*range(20), 19 + late]:
        actuator.command.rows.receive(tick, np.array([[5.0 if tick < 20 else 15.0]]), 0.0)
        voltage = actuator.voltage(tick)
    assert voltage.tolist() == [15.0] and not stub.warned


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(0.0, 3.0), min_size=1, max_size=30))
def test_the_slope_is_limited_in_time_where_writes_follow_late_ones(gaps):
    actuator, stub = made(0.7, axes=1)
    actuator.command.rows.receive(0, np.array([[UPPER]]), 0.0)
    for _ in range(10):
        actuator.voltage(0)
    now, last = 0.0, float(actuator.watchdog.applied[0])
    wanted = type(actuator).wanted
    for gap in gaps:
        now += gap * PERIOD
        stub.timer.now = now
        actuator.command.rows.receive(int(now / PERIOD), np.array([[UPPER]]), 0.0)
        voltage = wanted(actuator, int(now / PERIOD))
        most = 0.7 if gap >= 0.5 else 0.7 * gap
        assert abs(float(voltage[0]) - last) <= max(most, RATE * PERIOD * (not actuator.watchdog.following)) + 1e-9
        actuator.written(voltage)
        last = float(voltage[0])


def test_tells_at_most_once_per_interval():
    actuator, stub = made(axes=1)
    stub.period = 1e-3
    for tick in range(100, 121):
        actuator.tell(tick)
    assert [tick for tick, _ in stub.sent] == [100, 105, 110, 115, 120]


def test_reset_returns_to_the_start():
    actuator, _ = made(axes=1)
    actuator.command.rows.receive(0, np.array([[5.0]]), 0.0)
    actuator.voltage(0)
    actuator.reset()
    assert actuator.watchdog.applied.tolist() == [LOWER] and not actuator.watchdog.armed


@pytest.mark.parametrize(
    "safe, reason", [((1.0, 2.0, 3.0), "3 values, 2 axes"), ((0.0,), "within lower and upper"), ((1.0, 30.0), "0.1 to 20 V, got")]
)
def test_safe_command_that_cannot_be_is_one_line(safe, reason):
    with pytest.raises(InputError, match=f"stub: parameter safe_command: .*{reason}"):
        made(safe=safe)


def test_way_of_the_watchdog_ends_exactly_where_it_leads():
    """0.3 + (0.1 - 0.3) is less than 0.1: a sum would pass a safe value at the limit by its rounding."""
    watchdog = CommandWatchdog(np.array([0.3]), np.array([0.1]), 100.0, 0.01)
    watchdog.apply(np.array([0.3]))
    assert watchdog.apply(None).tolist() == [0.1]
