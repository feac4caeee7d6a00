"""PI feedback: one property per test."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from hyst_control.base.errors import InputError
from hyst_control.control.feedback.pi import PI


def rows(seed: int, count: int = 40, axes: int = 2) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((3, count, axes))


def test_unlimited_it_is_the_textbook_sum():
    reference, measurement, feedforward = rows(1)
    command, feedback = PI(2.0, 30.0, 1e-2, -1e9, 1e9).start(2).step(reference, measurement, feedforward)
    error = reference - measurement
    expected = 2.0 * error + 30.0 * 1e-2 * np.cumsum(error, axis=0)
    np.testing.assert_allclose(feedback, expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(command, feedforward + expected, rtol=1e-12, atol=1e-12)


def test_roll_off_is_the_textbook_filter_of_the_error():
    """The low-pass by scipy, whose pole is exp(-2 pi f T): at f = 0.1 / T a unit step has come to 1 - exp(-0.2 pi k) after k samples."""
    reference, measurement, feedforward = rows(1)
    _, feedback = PI(2.0, 30.0, 1e-2, -1e9, 1e9, roll_off=10.0).start(2).step(reference, measurement, feedforward)
    pole = np.exp(-0.2 * np.pi)
    error = lfilter([1.0 - pole], [1.0, -pole], reference - measurement, axis=0)
    np.testing.assert_allclose(feedback, 2.0 * error + 0.3 * np.cumsum(error, axis=0), rtol=1e-12, atol=1e-12)
    one, zero = np.ones((12, 1)), np.zeros((12, 1))
    _, step = PI(1.0, 0.0, 1e-2, -1e9, 1e9, roll_off=10.0).start(1).step(one, zero, zero)
    np.testing.assert_allclose(step[:, 0], 1.0 - pole ** np.arange(1, 13), rtol=1e-12)


@given(st.integers(0, 10**6))
def test_a_roll_off_far_above_the_sample_rate_is_none(seed):
    inputs = rows(seed)
    plain, rolled = (PI(3.0, 200.0, 1e-3, -1.0, 1.5, 400.0, roll_off=corner).start(2).step(*inputs) for corner in (0.0, 1e6))
    for one, other in zip(plain, rolled):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("roll_off", [0.0, 40.0])
@given(seed=st.integers(0, 10**6), cuts=st.lists(st.integers(1, 9), min_size=1, max_size=8))
def test_any_cutting_gives_the_same_bits(roll_off, seed, cuts):
    inputs = rows(seed, sum(cuts))
    description = PI(3.0, 200.0, 1e-3, -1.0, 1.5, 400.0, roll_off=roll_off)
    whole = description.start(2).step(*inputs)
    cut = description.start(2)
    edges = np.cumsum([0, *cuts])
    parts = [cut.step(*(signal[a:b] for signal in inputs)) for a, b in zip(edges[:-1], edges[1:])]
    for index in range(2):
        np.testing.assert_array_equal(np.concatenate([part[index] for part in parts]), whole[index])


@given(st.integers(0, 10**6))
def test_limits_and_slope_always_hold(seed):
    running = PI(50.0, 1e4, 1e-3, -1.0, 1.5, 300.0).start(2)
    running.reset(np.zeros(2))
    command, _ = running.step(*(10 * rows(seed)))
    assert command.min() >= -1.0 and command.max() <= 1.5
    assert np.abs(np.diff(command, axis=0, prepend=np.zeros((1, 2)))).max() <= 0.3 * (1 + 1e-12)


@pytest.mark.parametrize("roll_off", [0.0, 50.0])
def test_saturation_does_not_wind_up(roll_off):
    """However long it was at its limit; the low-pass alone takes some 5 samples to change sign."""
    description = PI(1.0, 100.0, 1e-3, -1.0, 1.0, roll_off=roll_off)
    for saturated in (100, 5000):
        running = description.start(1)
        one, none = np.ones((saturated, 1)), np.zeros((saturated, 1))
        assert running.step(10 * one, none, none)[0][-1, 0] == 1.0
        command, _ = running.step(-10 * one[:20], none[:20], none[:20])
        assert command[-1, 0] == -1.0


@pytest.mark.parametrize("roll_off", [0.0, 50.0])
def test_resume_continues_from_the_given_command(roll_off):
    running = PI(5.0, 70.0, 1e-3, -10.0, 10.0, 1.0, roll_off=roll_off).start(2)
    running.step(*rows(4, 7))
    reference, measurement, feedforward = rows(3, 1)
    running.resume(np.array([1.25, -2.0]), reference[0], measurement[0], feedforward[0])
    command, _ = running.step(reference[0], measurement[0], feedforward[0])
    np.testing.assert_allclose(command, [1.25, -2.0], atol=1e-12)


def test_without_integral_action_saturation_leaves_nothing_behind():
    running = PI(1.0, 0.0, 1e-3, 0.0, 50.0, 1000.0).start(1)
    running.reset(np.zeros(1))
    zero, ahead = np.zeros((60, 1)), np.full((60, 1), 40.0)
    assert running.step(zero, zero, ahead)[0][-1, 0] == 40.0


def test_ramp_reaches_its_target_at_the_rate_and_stays():
    running = PI(0.0, 0.0, 1e-3, 0.0, 100.0).start(1)
    running.reset(np.array([1.0]))
    np.testing.assert_allclose(running.ramp(np.zeros(1), 400.0, 4)[:, 0], [0.6, 0.2, 0.0, 0.0], atol=1e-12)


def test_integral_action_removes_the_error_of_a_first_order_plant():
    running = PI(0.2, 40.0, 1e-3, -100.0, 100.0).start(1)
    output = np.zeros(1)
    for _ in range(3000):
        command, _ = running.step(np.array([2.0]), output, np.zeros(1))
        output = output + 0.05 * (1.7 * command + 0.3 - output)
    np.testing.assert_allclose(output, 2.0, atol=1e-9)


@pytest.mark.parametrize(
    "change", [{"kp": -1.0}, {"ki": np.nan}, {"sample_time": 0.0}, {"lower": 5.0}, {"slew_limit": -1.0}, {"roll_off": -1.0}]
)
def test_senseless_values_are_refused_by_name(change):
    with pytest.raises(InputError, match=next(iter(change))):
        PI(**{"kp": 1.0, "ki": 1.0, "sample_time": 1e-3, "lower": 0.0, "upper": 5.0, **change})
