# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Watch over a sensor: samples that are counted by hand, loops that are well, and loops whose sensor dies or turns."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from hyst_control.control.feedback.pi import PI
from hyst_control.control.feedback.safe_loop import SafeLoop, Safety
from hyst_control.control.feedback.sensor_watch import FROZEN, MOTION, OUT_OF_RANGE, TURNED, MeasurementWatch


def faults(measured, commands, frozen_ticks=3, motion=1.0, wanted=None, watch=None):
    """Fault of a single axis at every sample."""
    watch = watch or MeasurementWatch(-5.0, 5.0, frozen_ticks, motion)
    wanted = measured if wanted is None else wanted
    return [
        (watch.check(np.array([value]), np.array([volts]), np.array([aim])) or ("",))[0]
        for value, volts, aim in zip(measured, commands, wanted)
    ]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_constant_measurement_is_frozen_once_its_command_has_moved(sign):
    commands = sign * np.array([0.0, 0.5, 1.0, 1.5, 1.5, 1.5, 1.5])
    assert faults(np.full(7, 2.0), commands) == ["", "", "", "", "", FROZEN, FROZEN]  # moved by more than 1 V from the fourth on


def test_motion_is_the_range_whichever_way_the_command_went():
    assert faults(np.zeros(6), [0.0, 0.6, 0.0, -0.6, -0.6, -0.6]) == ["", "", "", "", "", FROZEN]


def test_a_stage_at_rest_may_measure_a_constant_for_ever():
    assert set(faults(np.full(1000, 2.0), np.linspace(0.0, 1.0, 1000))) == {""}


def test_a_command_that_moves_slowly_asks_for_no_answer():
    """As against a drift that the loop takes off: 1 V within three frozen times is asked for."""
    assert set(faults(np.full(1000, 2.0), np.arange(1000) / 10.0)) == {""}
    assert FROZEN in faults(np.full(1000, 2.0), np.arange(1000) / 8.0)


def test_a_value_that_changes_begins_anew():
    assert faults([1.0, 1.0, 1.0, 2.0, 2.0, 2.0, 2.0], np.arange(7.0) * 2) == ["", "", "", "", "", "", FROZEN]


def test_the_last_digit_of_a_dead_sensor_is_no_answer_to_what_the_loop_asks_for():
    flicker, commands = 1.0 + 1e-3 * (np.arange(20) % 2), np.arange(20.0)
    assert set(faults(flicker, commands)) == {""}, "where nothing is asked for it may be all that there is to answer"
    assert faults(flicker, commands, wanted=np.full(20, 3.0))[-1] == FROZEN
    answer = 1.0 + 0.1 * np.arange(20)
    assert set(faults(answer, commands, wanted=np.full(20, 3.0))) == {""}


def test_a_sensor_found_dead_lives_again_with_a_motion_beyond_its_flicker_however_large_the_error_was():
    flicker, wanted = 1.0 + 1e-3 * (np.arange(20) % 2), np.full(20, 300.0)
    watch = MeasurementWatch(-500.0, 500.0, 3, 1.0)
    assert faults(flicker, np.arange(20.0), wanted=wanted, watch=watch)[-1] == FROZEN
    assert set(faults(flicker + 1e-3, np.full(20, 5.0), wanted=flicker, watch=watch)) == {FROZEN}
    assert set(faults(flicker + 0.01, np.full(20, 5.0), wanted=flicker, watch=watch)) == {""}


def test_never_frozen_and_out_of_range_on_either_side():
    assert set(faults(np.zeros(50), np.arange(50.0), frozen_ticks=0)) == {""}
    assert faults([5.0, 5.1, -5.0, -5.1, np.nan, 1.0], np.zeros(6)) == ["", OUT_OF_RANGE, "", OUT_OF_RANGE, OUT_OF_RANGE, ""]
    assert faults([np.nan, *np.linspace(0, 5, 50)], np.zeros(51))[1:] == [""] * 50


def test_a_reference_out_of_all_bounds_does_not_silence_the_watch_for_long():
    wanted = np.array([2.0, 1e308, np.inf, np.nan, *np.full(60, 2.0)])
    measured = np.append(0.01 * np.arange(64), np.full(40, 0.64))
    found = faults(measured, np.arange(104.0), wanted=np.append(wanted, np.full(40, 2.0)))
    assert set(found[20:64]) == {""} and found[-1] == FROZEN


def test_an_error_counts_no_more_than_the_stage_can_move():
    """A reference of 1e6 in a range of 2e6: once the gain is known, a motion of 2 % of the whole stroke still is an answer."""
    gain, volts = 0.1, 25.0 + 20.0 * np.sin(np.arange(400) / 10.0)
    wanted = np.where(np.arange(400) < 200, gain * volts, 1e6)
    watch = MeasurementWatch(-1e6, 1e6, 20, 0.5, (0.0, 50.0))
    assert set(faults(gain * volts, volts, wanted=wanted, watch=watch)) == {""}
    assert faults(np.full(200, 2.5), volts[:200], wanted=wanted[200:], watch=watch)[-1] == FROZEN


def test_axes_are_watched_one_by_one_and_afresh_when_their_number_changes_or_they_are_told_to():
    watch = MeasurementWatch(-5.0, 5.0, 2, 1.0)
    for k in range(3):
        found = watch.check(np.array([1.0, k, 9.0]), np.full(3, 2.0 * k))
    assert found == (FROZEN, "", OUT_OF_RANGE)
    assert watch.check(np.array([1.0]), np.array([9.0])) == ()
    assert faults(np.ones(4), 2.0 * np.arange(4), watch=watch)[-1] == FROZEN
    watch.forget()
    assert watch.check(np.array([1.0]), np.array([9.0])) == ()


def test_another_range_is_judged_by_from_the_next_sample_on():
    watch = MeasurementWatch(-5.0, 5.0, 3, 1.0)
    assert faults(np.full(2, 4.0), np.zeros(2), watch=watch) == ["", ""]
    watch.judge_by(MeasurementWatch(-5.0, 3.0, 3, 1.0))
    assert faults(np.full(2, 4.0), np.zeros(2), watch=watch) == [OUT_OF_RANGE] * 2


def test_before_there_is_a_command_nothing_is_asked():
    watch = MeasurementWatch(-5.0, 5.0, 3, 1.0)
    assert [watch.check(np.array([1.0]), np.array([np.nan])) for _ in range(10)] == [()] * 10
    assert set(faults(0.1 * np.arange(40), np.arange(40.0), watch=watch)) == {""}


WAY = np.concatenate([np.arange(40.0), 40.0 - np.arange(20.0)])
STAIRS = np.concatenate([5.0 * step + np.minimum(np.arange(30.0), 5.0) for step in range(4)])


def test_a_measurement_that_goes_against_its_command_has_turned_until_it_goes_with_it_again():
    gain, watch = 0.1, MeasurementWatch(-50.0, 50.0, 10, 1.0)
    assert set(faults(gain * WAY, WAY, watch=watch)) == {""}, "up and down"
    away = 20.0 + np.arange(30.0)
    found = faults(-gain * away, away, watch=watch)
    assert found[0] == "" and found[-1] == TURNED
    first = found.index(TURNED)
    assert 8 <= first <= 20, "8 V of the command, and what the low-pass takes"
    assert set(faults(-gain * np.full(50, 49.0), np.full(50, 49.0), watch=watch)) == {TURNED}, (
        "at rest nothing shows that it is well"
    )
    assert set(faults(-gain * (49.0 - np.arange(20)), 49.0 - np.arange(20), watch=watch)) == {TURNED}, (
        "on the way to the safe value too"
    )
    assert faults(gain * (29.0 + np.arange(20.0)), 29.0 + np.arange(20.0), watch=watch)[-1] == ""


@pytest.mark.parametrize(
    ("measured", "commands"),
    [
        (-0.03 * WAY[:20], WAY[:20]),  # too little
        (-0.5 * WAY[:20], WAY[:20]),  # too much
        (np.repeat([0.5, -0.5], 30), WAY),  # a jump is none of the command's doing
        (-0.1 * (WAY % 6), WAY % 6),  # to and fro
        (-0.1 * WAY / 12, WAY / 12),  # slowly, as a drift
        (-0.1 * STAIRS, STAIRS),  # slowly, step by step
    ],
)
def test_other_movements_are_those_of_disturbances(measured, commands):
    watch = MeasurementWatch(-50.0, 50.0, 10, 1.0)
    faults(0.1 * WAY, WAY, watch=watch)
    assert TURNED not in faults(0.1 * 21.0 + measured, 21.0 + commands, watch=watch)


RATE, UPPER, GAIN = 1000.0, 150.0, 0.08  # Hz, V, um/V


def run(seconds, reference, disturbance=None, noise=0.0, sensor=None, kp=0.2, ki=100.0, feedforward=0.0, lag=2e-3):
    """Commands and faults of a loop around a stage with a lag and a tick of delay."""
    ticks = np.arange(round(seconds * RATE))
    wanted = reference(ticks / RATE) * np.minimum(ticks / 100, 1.0)
    shaken = noise * np.random.default_rng(0).normal(size=len(ticks))
    shaken += 0.0 if disturbance is None else disturbance(ticks / RATE)
    frozen = round(0.1 * RATE)
    watch = MeasurementWatch(-1e6, 1e6, frozen, MOTION * UPPER)
    loop = SafeLoop(PI(kp, ki, 1 / RATE, 0.0, UPPER, 2e4).start(1), watch, Safety(np.zeros(1), 500.0, frozen))
    loop.restart(np.zeros(1), away=False)
    position, volts, share, commands, found = 0.0, 0.0, 1 - np.exp(-1 / (lag * RATE)), [], []
    for tick in ticks:
        measured = position + shaken[tick]
        measured = measured if sensor is None else sensor(measured, tick)
        command = loop.closed(*(np.array([[each]]) for each in (wanted[tick], measured, feedforward * wanted[tick])))[0][0, 0]
        position += share * (GAIN * volts - position)
        volts = command
        commands.append(command)
        found.append(loop.faults.present[0])
    return np.array(commands), found


def tracking(time):
    return 4.0 + 2.0 * np.sin(2 * np.pi * 10.0 * time)


@pytest.mark.parametrize("feedforward", [0.0, 1 / GAIN])
@pytest.mark.parametrize("when", [500, 520, 550, 580])
def test_a_dead_sensor_whose_last_digit_flickers_is_found_before_the_command_runs_away(when, feedforward):
    commands, found = run(1.0, tracking, sensor=lambda m, k: m if k < when else 3.7 + 1e-4 * (k % 2), feedforward=feedforward)
    assert set(found[:when]) == {""} and set(found[when + 200 :]) == {FROZEN}
    assert commands[when:].max() < 0.7 * UPPER and commands[-1] == 0.0


def test_a_sensor_that_is_dead_from_the_start_is_found_too():
    commands, found = run(1.0, tracking, sensor=lambda m, k: 1e-4 * (k % 2))
    assert set(found[200:]) == {FROZEN} and commands.max() < 0.5 * UPPER


@pytest.mark.parametrize("feedforward", [0.0, 1 / GAIN])
@pytest.mark.parametrize("when", [500, 520, 550, 580])
def test_a_sensor_whose_sign_turns_is_found_before_the_command_is_at_its_limit(when, feedforward):
    commands, found = run(1.0, tracking, sensor=lambda m, k: m if k < when else -m, feedforward=feedforward)
    assert set(found[:when]) == {""} and set(found[when + 110 :]) == {TURNED}
    assert commands[when:].max() < 0.75 * UPPER and commands[-1] == 0.0


def test_a_sensor_that_is_turned_from_the_start_is_found_too():
    commands, found = run(1.0, tracking, sensor=lambda m, k: -m)
    assert found[-1] == TURNED and commands[-1] == 0.0


SLOW_LOOP = (0.0, 30.0)  # kp, ki: 0.4 Hz


@settings(max_examples=25, deadline=None)
@given(
    st.floats(0.0, 2.5),
    st.floats(0.3, 15.0),
    st.sampled_from([np.sin, lambda x: np.sign(np.sin(x)), lambda x: np.arcsin(np.sin(x)) / 1.6]),
    st.floats(0.0, 0.6),
    st.floats(0.3, 100.0),
    st.sampled_from([0.0, 1e-4, 3e-3, 0.05]),
    st.sampled_from([SLOW_LOOP, (0.2, 100.0), (1.0, 500.0), (3.0, 1500.0)]),
    st.sampled_from([0.0, 0.8 / GAIN, 1.0 / GAIN]),
)
def test_a_loop_that_is_well_has_no_fault(amplitude, frequency, shape, vibration, at, noise, gains, feedforward):
    """References of any amplitude, vibrations of up to 5 % of the stroke, a step of the load, noise, slow and fast loops."""
    assume(gains != SLOW_LOOP or vibration < 0.3 or at > 10.0)  # see the test below
    found = run(
        2.0,
        lambda time: 4.0 + amplitude * shape(2 * np.pi * frequency * time),
        lambda time: vibration * np.sin(2 * np.pi * at * time) + 0.5 * (time > 1.0),
        noise,
        kp=gains[0],
        ki=gains[1],
        feedforward=feedforward,
    )[1]
    assert set(found) == {""}


@pytest.mark.xfail(strict=True, reason="at its crest the measurement stays within 2 % of the error for the frozen time")
@pytest.mark.parametrize(("vibration", "at"), [(0.5625, 2.0), (0.6, 0.5), (0.5, 3.0)])
def test_a_slow_loop_that_is_shaken_slowly_is_well(vibration, at):
    """Known fault, a false stop: for a while the disturbance compensates the motion of the command."""
    kp, ki = SLOW_LOOP
    shaken = lambda time: vibration * np.sin(2 * np.pi * at * time) + 0.5 * (time > 1.0)  # noqa: E731 one line says it
    assert set(run(2.0, lambda time: np.full_like(time, 4.0), shaken, kp=kp, ki=ki)[1]) == {""}
