"""Gains, limits and signals that change while the loop runs: the step of the command at the change, against a closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import betainc

from hyst_control.base.errors import InputError
from hyst_control.control.feedback.pi import PI
from hyst_control.control.feedback.safe_loop import SafeLoop, Safety
from hyst_control.control.feedback.sensor_watch import MeasurementWatch
from hyst_control.records.excitation.signal_change import ChangingSignal

PERIOD, RATE = 1e-3, 500.0  # s, V/s
BEFORE = PI(kp=0.8, ki=40.0, sample_time=PERIOD, lower=0.0, upper=100.0)


def loop(description=BEFORE, axes=1, rate=RATE):
    found = SafeLoop(description.start(axes), MeasurementWatch(-1e6, 1e6, 0, 1.0), Safety(np.zeros(axes), rate))
    found.restart(None, away=False)
    return found


def inputs(ticks, seed=0, level=20.0):
    rng = np.random.default_rng(seed)
    return rng.normal(3.0, 0.4, ticks), rng.normal(2.0, 0.4, ticks), level + rng.normal(0.0, 0.1, ticks)


def ran(running, signals, change_at=None, change=None):
    rows = []
    for tick, (reference, measurement, feedforward) in enumerate(zip(*signals, strict=True)):
        if tick == change_at:
            running.change(change)
        rows.append(running.closed(*(np.array([[each]]) for each in (reference, measurement, feedforward)))[0][0, 0])
    return np.array(rows)


@pytest.mark.parametrize("roll_off", [0.0, 60.0])
@pytest.mark.parametrize("new", [{"kp": 3.0}, {"kp": 0.0}, {"ki": 900.0}, {"kp": 2.0, "ki": 5.0}])
def test_a_gain_changes_the_command_by_no_more_than_the_new_integral_of_one_tick(new, roll_off):
    before = replace(BEFORE, roll_off=roll_off)
    after, at = replace(before, **new), 200
    signals = inputs(400)
    steady, changed = ran(loop(before), signals), ran(loop(before), signals, at, after)
    error, share = signals[0] - signals[1], before.roll_off_share
    rolled = 0.0
    for each in error[: at + 1]:
        rolled += share * (each - rolled)
    np.testing.assert_array_equal(changed[:at], steady[:at])
    assert changed[at] - steady[at] == pytest.approx((after.ki - before.ki) * PERIOD * rolled, abs=1e-9)
    # from then on it is the new law, from the integral that the change left
    other = loop(after)
    other.controller.resume(changed[at : at + 1], *(each[at : at + 1] for each in signals))
    if not roll_off:
        np.testing.assert_allclose(ran(other, [each[at:] for each in signals]), changed[at:], rtol=0, atol=1e-9)


def test_a_roll_off_that_comes_or_goes_makes_no_step():
    signals = inputs(300, seed=1)
    for before, after in ((BEFORE, replace(BEFORE, roll_off=30.0)), (replace(BEFORE, roll_off=30.0), BEFORE)):
        steady, changed = ran(loop(before), signals), ran(loop(before), signals, 150, after)
        rolled = abs(signals[0] - signals[1]).max()
        assert abs(changed[150] - steady[150]) <= BEFORE.ki * PERIOD * 2 * rolled


def test_without_integral_action_the_command_goes_to_the_new_law_at_the_safe_rate():
    before, after = replace(BEFORE, ki=0.0), replace(BEFORE, ki=0.0, kp=30.0)
    constant = (np.full(200, 3.0), np.full(200, 2.0), np.full(200, 20.0))
    commands = ran(loop(before), constant, 100, after)
    assert commands[99] == pytest.approx(20.8) and commands[-1] == pytest.approx(50.0)
    np.testing.assert_allclose(np.diff(commands)[99 : 99 + 58], RATE * PERIOD)
    assert np.abs(np.diff(commands)).max() <= RATE * PERIOD + 1e-9


@pytest.mark.parametrize(
    "new", [{"upper": 12.0}, {"lower": 30.0}, {"lower": 25.0, "upper": 28.0}, {"lower": 100.0, "upper": 140.0}]
)
def test_narrower_limits_are_reached_at_the_safe_rate(new):
    after, at, ticks = replace(BEFORE, **new), 50, 500
    constant = (np.full(ticks, 2.0), np.full(ticks, 2.0), np.full(ticks, 20.0))
    commands = ran(loop(), constant, at, after)
    target = np.clip(20.0, after.lower, after.upper)
    way = np.minimum(np.arange(1, ticks - at + 1) * RATE * PERIOD, abs(target - 20.0))
    np.testing.assert_allclose(commands[at:], 20.0 + np.sign(target - 20.0) * way, rtol=0, atol=1e-9)


def test_limits_beyond_the_command_hold_at_once():
    running = loop()
    constant = (np.full(20, 2.0), np.full(20, 2.0), np.full(20, 20.0))
    ran(running, constant, 10, replace(BEFORE, upper=40.0))
    command = running.closed(np.array([[2.0]]), np.array([[2.0]]), np.array([[90.0]]))[0]
    assert command[0, 0] == 40.0


def test_wider_limits_let_a_limited_command_go_at_the_safe_rate():
    before = replace(BEFORE, upper=20.0, ki=0.0)
    constant = (np.full(300, 2.0), np.full(300, 2.0), np.full(300, 60.0))
    commands = ran(loop(before), constant, 100, replace(before, upper=100.0))
    np.testing.assert_allclose(commands[100:180], 20.0 + RATE * PERIOD * np.arange(1, 81), rtol=0, atol=1e-9)
    assert commands[-1] == 60.0


def test_limits_travel_in_open_loop_and_while_stopped_whatever_the_blocks():
    for block in (1, 7, 100):
        running = loop()
        rows = [running.open(np.full((1, 1), 20.0))[0]]
        running.change(replace(BEFORE, upper=10.0))
        rows += [running.open(np.full((min(block, 100 - begin), 1), 20.0))[0] for begin in range(0, 100, block)]
        np.testing.assert_allclose(
            np.concatenate(rows)[:, 0], np.maximum(20.0 - RATE * PERIOD * np.arange(101), 10.0), rtol=0, atol=1e-9
        )
    running = loop()
    running.open(np.full((1, 1), 20.0))
    running.change(replace(BEFORE, lower=15.0))
    commands = running.stopped_by("a fault", 100)[0][:, 0]
    assert np.abs(np.diff([20.0, *commands])).max() <= RATE * PERIOD + 1e-9 and commands[-1] == 15.0


def test_a_description_that_makes_no_sense_is_refused():
    with pytest.raises(InputError, match="lower"):
        replace(BEFORE, lower=200.0)


def test_a_signal_gives_way_to_another_without_a_jump():
    rows = np.arange(1000)
    old, new = np.sin(rows / 30.0)[:, None], (4.0 + 0.3 * np.sin(rows / 11.0))[:, None]
    signal, at, fade = ChangingSignal(old, repeat=False), 400, 100
    signal.replace(new, at, fade)
    found = signal.rows(0, 1000)
    np.testing.assert_array_equal(found[:at], old[:at])
    np.testing.assert_allclose(found[at + fade :], new[at + fade :], rtol=0, atol=1e-15)
    weight = betainc(3, 3, np.minimum(rows - at + 1, fade).clip(0) / fade)[
        :, None
    ]  # the integral of a bump that is 0 with its slope
    np.testing.assert_allclose(found, old + weight * (new - old), rtol=0, atol=1e-12)
    for step in (1, 13, 999):  # however the rows are asked for
        cut = [signal.rows(first, min(step, 1000 - first)) for first in range(0, 1000, step)]
        np.testing.assert_array_equal(np.concatenate(cut), found)


def test_a_signal_may_change_again_during_a_change_and_repeats():
    signal = ChangingSignal(np.zeros((10, 1)), repeat=True)
    signal.replace(np.full((10, 1), 8.0), 15, 20)
    before = signal.rows(0, 25)
    signal.replace(np.full((7, 1), -2.0), 25, 20)
    found = signal.rows(0, 80)
    np.testing.assert_array_equal(found[:25], before)
    assert np.abs(np.diff(found[:, 0])).max() <= 10.0 * 1.875 / 20 and found[-1, 0] == -2.0


SINE = 3.0 + 2.0 * np.sin(np.arange(400) * 2 * np.pi / 80)[:, None]


@pytest.mark.parametrize("repeat", [False, True])
def test_a_signal_begins_at_rest_where_the_stage_is_and_ends_at_rest(repeat):
    signal = ChangingSignal(SINE, repeat, 100, 100)
    signal.begin_at(np.array([0.7]))
    found, k = signal.rows(0, 1000)[:, 0], np.arange(100)
    plain = SINE[np.arange(1000) % 400, 0] if repeat else np.append(SINE[:, 0], np.full(600, SINE[-1, 0]))
    np.testing.assert_allclose(found[:100], 0.7 + betainc(3, 3, (k + 1) / 100) * (plain[:100] - 0.7), rtol=0, atol=1e-12)
    np.testing.assert_array_equal(found[100:300], plain[100:300])
    steepest = np.abs(np.diff(SINE[:, 0])).max()
    assert abs(found[0] - 0.7) < 0.01 * steepest and abs(found[1] - found[0]) < 0.01 * steepest
    if not repeat:
        assert found[399] == plain[399] and abs(found[399] - found[398]) < 0.01 * steepest
        assert np.all(found[400:] == plain[399])
    else:
        np.testing.assert_array_equal(found[300:], plain[300:])
    jerk = np.abs(np.diff(found, 3)).max()
    assert jerk < 1.5 * np.abs(np.diff(SINE[:, 0], 3)).max() + 60 * 5.0 / 100**3, "of the sine, and of the ramp of 5 um"


def test_a_signal_that_is_at_rest_at_its_ends_stays_as_it_is():
    hills = (1 - np.cos(np.arange(401) * 2 * np.pi / 80))[:, None]
    signal = ChangingSignal(hills, False, 100, 100)
    signal.begin_at(np.zeros(1))
    np.testing.assert_array_equal(signal.rows(0, 401), hills)
    still = ChangingSignal(np.full((1, 1), 3.0), False, 100, 100)
    still.begin_at(np.zeros(1))
    np.testing.assert_allclose(still.rows(0, 120)[:, 0], 3.0 * betainc(3, 3, np.minimum(np.arange(120) + 1, 100) / 100), atol=1e-12)


def test_a_signal_that_takes_the_place_of_another_ends_at_rest_too():
    signal = ChangingSignal(SINE, False, 40, 40)
    signal.begin_at(np.zeros(1))
    signal.replace(2.0 * SINE, 200, 50)
    found = signal.rows(0, 500)[:, 0]
    np.testing.assert_array_equal(found[250:360], 2.0 * SINE[250:360, 0])
    assert np.all(found[399:] == 2.0 * SINE[-1, 0]) and abs(found[399] - found[398]) < 0.02
    late = ChangingSignal(SINE, False, 40, 40)
    late.replace(2.0 * SINE, 395, 50)  # no more than the ramp is left of it
    assert np.abs(np.diff(late.rows(380, 100)[:, 0])).max() < 2.0
    assert late.rows(600, 1)[0, 0] == 2.0 * SINE[-1, 0]


@given(st.lists(st.floats(-5, 5), min_size=1, max_size=40), st.floats(-5, 5), st.integers(0, 30), st.booleans())
def test_a_ramp_never_leaves_the_range_of_the_signal_and_of_where_it_begins(values, position, ramp, repeat):
    signal = ChangingSignal(np.array(values)[:, None], repeat, ramp, ramp)
    signal.begin_at(np.array([position]))
    found = signal.rows(0, 100)[:, 0]
    assert found.min() >= min(*values, position) - 1e-12 and found.max() <= max(*values, position) + 1e-12
    np.testing.assert_array_equal(np.concatenate([signal.rows(k, 1) for k in range(100)])[:, 0], found)
