# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The fault state machine and the watchdog of the actuator, driven with anything: what comes out is finite, bounded and smooth."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hyst_control.control.feedback.command_limits import CommandLimits
from hyst_control.control.feedback.command_watchdog import CommandWatchdog
from hyst_control.control.feedback.pi import PI
from hyst_control.control.feedback.safe_loop import OVERFLOW, AxisFaults, SafeLoop, Safety
from hyst_control.control.feedback.sensor_watch import OUT_OF_RANGE, MeasurementWatch

PERIOD, LOWER, UPPER, SLEW, RATE, SAFE = 1e-2, -5.0, 20.0, 300.0, 100.0, 2.0
STEP = SLEW * PERIOD * (1 + 1e-9)


def made(axes=2, kp=1.0, ki=50.0, roll_off=0.0, start=0.0, frozen=0, **safety):
    controller = PI(kp, ki, PERIOD, LOWER, UPPER, SLEW, roll_off=roll_off).start(axes)
    watch = MeasurementWatch(-100.0, 100.0, frozen, 0.5)
    loop = SafeLoop(controller, watch, Safety(np.full(axes, SAFE), RATE, **{"recovery_ticks": 3, **safety}))
    loop.restart(np.full(axes, start), away=False)
    return loop


ANY = st.one_of(st.floats(), st.floats(-30, 30), st.sampled_from([1.7e308, -1.7e308, math.nan, math.inf, 0.0, 1e12, 5e-324]))
PAIR = st.tuples(ANY, ANY)
EVENTS = st.lists(
    st.one_of(
        st.tuples(st.just("closed"), PAIR, PAIR, PAIR, st.sampled_from(["", "", "", "stale"])),
        st.tuples(st.just("open"), st.lists(PAIR, min_size=1, max_size=4), st.sampled_from(["", "", "rival"])),
        st.tuples(st.just("stopped"), st.integers(1, 4)),
        st.tuples(st.just("enabled"), st.booleans()),
        st.tuples(st.just("restart"), st.booleans()),
        st.tuples(st.just("applied"), st.one_of(st.none(), PAIR)),
        st.tuples(st.just("safety"), st.booleans(), st.booleans()),
    ),
    max_size=60,
)


@settings(max_examples=300, deadline=None)
@given(EVENTS, st.sampled_from([0.0, 50.0, 1e12]), st.sampled_from([0.0, 1.0, 1e9]), st.sampled_from([0.0, 20.0]))
def test_every_row_is_finite_within_the_limits_and_follows_on_the_last_one(events, ki, kp, roll_off):
    loop, last = made(kp=kp, ki=ki, roll_off=roll_off, frozen=4), np.zeros(2)
    for kind, *given_values in events:
        rows = np.empty((0, 2))
        with np.errstate(all="ignore"):
            if kind == "closed":
                *signals, fault = given_values
                rows, feedback = loop.closed(*(np.array([signal]) for signal in signals), fault)
                assert np.isfinite(feedback).all()
            elif kind == "open":
                rows, feedback = loop.open(np.array(given_values[0]), given_values[1])
                assert not feedback.any() and len(rows) == len(given_values[0])
            elif kind == "stopped":
                rows, _ = loop.stopped_by("", given_values[0])
            elif kind == "enabled":
                loop.enabled = given_values[0]
            elif kind == "applied":
                loop.applied = None if given_values[0] is None else np.array(given_values[0])
            elif kind == "restart":
                loop.restart(loop.controller.command, away=given_values[0])
            else:
                loop.safety = replace(loop.safety, manual=given_values[0], stop_all=given_values[1])
        for row in rows:
            assert np.isfinite(row).all() and row.min() >= LOWER and row.max() <= UPPER
            assert np.abs(row - last).max() <= STEP
            last = row
        assert np.isfinite(loop.controller._state).all()


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(PAIR, PAIR, PAIR), max_size=20), st.booleans())
@example(
    [((0.0, 0.0), (7e16, 0.25), (0.0, -1.0)), ((0.0, 27.0), (0.0, 0.0), (0.0, 0.0)), ((0.0, 95.0), (0.0, 0.0), (0.0, 0.0))], False
)
def test_it_recovers_from_whatever_has_come(events, stop_all):
    """However bad the inputs were, after the recovery time with sound ones the loop runs, and tracks."""
    loop = made(stop_all=stop_all, frozen=4)
    with np.errstate(all="ignore"):
        for signals in events:
            loop.closed(*(np.array([signal]) for signal in signals))
    position = np.zeros((1, 2))
    wanted = np.array([[1.0, 2.0]])
    for k in range(2500):  # what an absurd feedforward left in the integral is halved from tick to tick
        measured = position + 1e-4 * k  # A sensor that was found dead lives again once it moves by more than it flickered
        command, _ = loop.closed(wanted, measured, np.zeros((1, 2)))
        position = command / 5.0
    np.testing.assert_allclose(measured, wanted, atol=0.01)
    assert loop.faults.present == ["", ""] and not loop.away


def test_without_a_fault_it_is_the_controller_to_the_last_bit():
    random = np.random.default_rng(0)
    loop, plain = made(), PI(1.0, 50.0, PERIOD, LOWER, UPPER, SLEW).start(2)
    plain.reset(np.zeros(2))
    for _ in range(500):
        signals = random.normal(0, 5, (3, 1, 2))
        for one, other in zip(loop.closed(*signals), plain.step(*signals)):
            np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("stop_all", [True, False])
def test_fault_of_one_axis_stops_it_and_the_others_only_if_told_so(stop_all):
    loop = made(stop_all=stop_all)
    one = np.ones((1, 2))
    for k in range(50):
        loop.closed(one * (1 + 0.01 * k), 0 * one + 0.001 * k, 10 * one)
    for k in range(50):
        loop.closed(one, np.array([[1000.0, 0.001 * k]]), 10 * one)
    assert loop.faults.present == [OUT_OF_RANGE, ""] and loop.faults.raised == 1
    command = loop.controller.command
    assert command[0] == SAFE and (command[1] == SAFE if stop_all else command[1] > 10.0)
    assert loop.at_safe_value == stop_all


def test_overflow_holds_the_command_is_a_fault_and_ends():
    loop = made(kp=10.0)
    calm = np.full((1, 2), 1.0)
    for k in range(20):
        before, _ = loop.closed(calm, calm + 1e-3 * k, 10 * calm)
    held, feedback = loop.closed(np.array([[1.7e308, 1.0]]), calm, 10 * calm)
    assert held[0, 0] == before[0, 0] and feedback[0, 0] == 0.0
    loop.closed(calm, calm, 10 * calm)
    assert loop.faults.present == [OVERFLOW, ""]
    for k in range(10):
        loop.closed(calm, calm + 1e-3 * k, 10 * calm)
    assert loop.faults.present == ["", ""]


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 4)), max_size=30), st.integers(1, 6))
def test_a_fault_lasts_until_none_was_there_for_the_recovery_time(events, recovery):
    faults, safety = AxisFaults(1), Safety(np.zeros(1), 1.0, recovery)
    well, present = 0, False
    for bad, ticks in events:
        faults.update(["bad" if bad else ""], ticks, safety)
        well = 0 if bad else well + max(ticks, 1)
        present = bad or present and well < recovery
        assert faults.any == present


COMMANDS = st.lists(
    st.one_of(
        st.none(),
        st.tuples(st.floats(-50, 50), st.floats(-50, 50), st.booleans()),
        st.tuples(st.just(math.nan), st.just(0.0), st.just(True)),
    ),
    max_size=80,
)


@given(COMMANDS)
def test_watchdog_moves_the_actuator_no_faster_than_its_rate_or_its_command(commands):
    """Without trust at its rate; while it follows as the command moves; and from the one to the other without a jump."""
    watchdog = CommandWatchdog(np.zeros(2), np.full(2, SAFE), RATE, PERIOD)
    last, before, step = np.zeros(2), None, RATE * PERIOD * (1 + 1e-9)
    for given_command in commands:
        command = None if given_command is None else np.array(given_command[:2])
        trusted = given_command is not None and given_command[2] and np.isfinite(command).all()
        applied = watchdog.apply(command, given_command is not None and given_command[2])
        assert np.isfinite(applied).all()
        moved = np.abs(before - command) if trusted and before is not None else np.zeros(2)
        assert np.all(np.abs(applied - last) <= np.maximum(step, moved + 1e-9))
        if watchdog.following:
            np.testing.assert_array_equal(applied, command)
        last, before = applied, command if trusted else None


def test_watchdog_goes_to_its_safe_value_stays_there_and_meets_the_command_again():
    watchdog = CommandWatchdog(np.zeros(1), np.array([SAFE]), RATE, PERIOD)
    assert all(watchdog.apply(None)[0] == 0.0 for _ in range(5))  # nothing to bring to safety yet
    rising = [watchdog.apply(np.array([10.0]))[0] for _ in range(15)]
    np.testing.assert_allclose(np.diff(rising[:10]), RATE * PERIOD)
    assert watchdog.following and rising[-1] == 10.0
    falling = [watchdog.apply(np.array([10.0]), trusted=False)[0] for _ in range(20)]
    np.testing.assert_allclose(falling[:8], 10.0 - RATE * PERIOD * np.arange(1, 9))
    assert falling[-1] == SAFE
    fast = [float(watchdog.apply(np.array([8.0 + 6.0 * np.sin(2.1 * k)]))[0]) for k in range(60)]
    assert watchdog.following and fast[-1] == 8.0 + 6.0 * np.sin(2.1 * 59)


@pytest.mark.parametrize("ki", [50.0, 0.0])
def test_an_axis_whose_actuator_does_not_follow_tracks_what_is_applied(ki):
    """It goes there within the slew limit, waits, and goes on from there: by its integral, or at the safe rate without one."""
    loop, calm = made(kp=2.0, ki=ki, start=10.0), np.full((1, 2), 1.0)
    other = []

    def run(ticks):
        rows = np.concatenate([loop.closed(5 * calm, 4 * calm + 1e-3 * k, 8 * calm)[0] for k in range(ticks)])
        other.append(rows[:, 1])
        return rows[:, 0]

    before = run(5)
    loop.applied = np.array([-1.0, np.nan])
    tracked = run(20)
    assert np.abs(np.diff([before[-1], *tracked])).max() <= STEP
    np.testing.assert_array_equal(tracked[8:], -1.0)
    assert loop.away and loop.faults.present == ["", ""], "it is no fault"
    loop.applied = None
    back = run(200)
    error = 1.0
    assert abs(back[0] - tracked[-1]) <= max(ki * PERIOD * error, RATE * PERIOD if not ki else 0.0) * (1 + 1e-9)
    assert back[-1] > 9.0 and not loop.away
    plain = made(kp=2.0, ki=ki, start=10.0)
    rows = [plain.closed(5 * calm, 4 * calm + 1e-3 * k, 8 * calm)[0][0, 1] for n in (5, 20, 200) for k in range(n)]
    np.testing.assert_array_equal(np.concatenate(other), rows, "the other axis goes on as if nothing was")


def test_watchdog_passes_fresh_commands_unchanged():
    watchdog, random = CommandWatchdog(np.zeros(1), np.zeros(1), RATE, PERIOD), np.random.default_rng(1)
    watchdog.apply(np.zeros(1))
    for row in random.normal(0, 30, (100, 1)):
        assert watchdog.apply(row) is row


def test_open_loop_stops_at_a_fault_and_comes_back():
    """A fault of the loop leads every axis to the safe value at the safe rate; afterwards it is led back to the feedforward."""
    loop = made()
    rows = np.full((40, 2), 10.0)
    command, _ = loop.open(rows)
    np.testing.assert_array_equal(command[-1], [10.0, 10.0])
    assert not loop.away
    stopped = np.concatenate([loop.open(rows[:5], "stale")[0] for _ in range(3)])
    np.testing.assert_allclose(stopped[:, 0], np.maximum(10.0 - RATE * PERIOD * np.arange(1, 16), SAFE), atol=1e-12)
    assert loop.away and loop.at_safe_value
    back = np.concatenate([loop.open(rows[:1])[0] for _ in range(30)])
    assert back[0, 0] == SAFE and back[-1, 0] == 10.0
    assert np.abs(np.diff(back[:, 0])).max() <= RATE * PERIOD * (1 + 1e-9)
    assert not loop.away and loop.faults.present == ["", ""]


def test_what_happens_at_every_tick_and_in_long_blocks_takes_the_short_way(monkeypatch):
    """A loop that is well is one step of its controller, and a block of a stopped one is one ramp."""
    loop = made()
    monkeypatch.setattr(loop, "_running", lambda *_: pytest.fail("the faults of a loop that is well are looked through"))
    loop.closed(*np.full((3, 1, 2), 1.0))
    loop.open(np.full((3, 2), 1.0))
    monkeypatch.undo()
    ramps = []
    ramp = loop.controller.ramp
    monkeypatch.setattr(loop.controller, "ramp", lambda *given: ramps.append(given) or ramp(*given))
    assert len(loop.open(np.full((1000, 2), 10.0), "stale")[0]) == 1000 and len(ramps) == 1
    saturated = loop.controller.saturated
    loop.closed(*np.full((3, 1, 2), 1e6), "stale")
    assert loop.controller.saturated == saturated, "a stopped controller is asked for nothing"


def test_one_axis_in_open_loop_stops_alone_if_told_so():
    """An axis whose controller overflows is stopped; the other goes on with its feedforward."""
    loop = made(stop_all=False)
    loop.open(np.full((40, 2), 10.0))
    loop._overflowed = (0,)
    command = np.concatenate([loop.open(np.full((1, 2), 10.0))[0] for _ in range(2)])
    np.testing.assert_allclose(command, [[9.0, 10.0], [8.0, 10.0]], atol=1e-12)
    assert loop.faults.present == [OVERFLOW, ""]


def test_without_integral_action_a_stopped_axis_is_led_back():
    """Proportional control has no state that remembers the command: the way back is a ramp at the safe rate, without a jump."""
    loop = made(kp=5.0, ki=0.0)
    wanted, measured = np.full((1, 2), 2.0), np.zeros((1, 2))
    for k in range(20):
        loop.closed(wanted, measured + 1e-3 * k, measured)
    np.testing.assert_allclose(loop.controller.command, 10.0, atol=0.2)
    for k in range(30):
        loop.closed(wanted, measured + 1e-3 * k, measured, "stale")
    np.testing.assert_array_equal(loop.controller.command, [SAFE, SAFE])
    last, rows = loop.controller.command, []
    for k in range(30):
        rows.append(loop.closed(wanted, measured + 1e-3 * k, measured)[0][0])
    steps = np.diff(np.array([last, *rows]), axis=0)
    assert np.abs(steps).max() <= RATE * PERIOD * (1 + 1e-9)
    np.testing.assert_allclose(rows[-1], 10.0, atol=0.2)
    assert not loop.away


def test_limits_go_on_to_their_new_values_while_the_loop_is_stopped():
    loop = made()
    loop.open(np.full((60, 2), 15.0))
    loop.change(replace(loop.controller.description, upper=12.0))
    command = np.concatenate([loop.stopped_by("stale", 2)[0] for _ in range(5)])
    np.testing.assert_allclose(command[:, 0], np.maximum(15.0 - RATE * PERIOD * np.arange(1, 11), SAFE), atol=1e-12)
    assert loop.controller.description.upper == 12.0
    assert loop._limits is None, "nothing is left to move"


@pytest.mark.parametrize("fault", ["", "stale"])
@pytest.mark.parametrize("way", ["closed", "open", "open block", "stopped_by"])
def test_limits_move_by_the_safe_rate_in_every_tick_whatever_the_loop_does(way, fault):
    loop = made()
    loop.open(np.full((10, 2), 5.0))
    loop.change(replace(loop.controller.description, upper=30.0))
    rows = np.full((1, 2), 5.0)
    for ticks in (2, 4, 6):
        if way == "open block":
            loop.open(np.repeat(rows, 2, axis=0), fault)
        elif way == "stopped_by":
            loop.stopped_by(fault, 2)
        else:
            for _ in range(2):
                loop.open(rows, fault) if way == "open" else loop.closed(rows, rows, rows, fault)
        np.testing.assert_allclose(loop.controller.description.upper, UPPER + ticks * RATE * PERIOD, atol=1e-12)


@pytest.mark.parametrize("axes", [2, 5000])
def test_one_axis_of_many_is_limited_and_a_nan_among_them_is_no_command(axes):
    limits, applied = CommandLimits(-1.0, 1.0), np.zeros(axes)
    command = np.linspace(-1.0, 1.0, axes)
    assert limits.limited(command, applied) is command
    beyond = command.copy()
    beyond[-1] = 1.5
    np.testing.assert_array_equal(limits.limited(beyond, applied), command)
    watchdog = CommandWatchdog(applied, applied, 1e6, 1e-3)
    np.testing.assert_array_equal(watchdog.apply(command), command)
    assert watchdog.following
    beyond[axes // 2] = math.nan
    assert np.isfinite(watchdog.apply(beyond)).all() and not watchdog.following
    assert limits.limited(beyond, applied) is not beyond
