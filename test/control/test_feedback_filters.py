# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Filters of the feedback against scipy's filters of the continuous transfer functions' sampled forms, and their corner cases."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import cont2discrete, freqs, freqz, lfilter

from hyst_control.base.errors import InputError
from hyst_control.control.feedback.filters import Filters, response
from hyst_control.control.feedback.pi import PI

T = 1e-3
ALL = Filters(0.002, 150.0, (60.0, 210.0), (0.7, 0.3), (0.1, 0.02), 0.4, 30.0)


def errors(seed: int, count: int = 60) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((count, 2))


def feedback(law: PI, error: np.ndarray) -> np.ndarray:
    return law.start(error.shape[1]).step(error, np.zeros_like(error), np.zeros_like(error))[1]


def notch(frequency: float, width: float, depth: float) -> tuple[list[float], list[float]]:
    w = 2 * np.pi * frequency
    return [1.0, 2 * depth * width * w, w**2], [1.0, 2 * width * w, w**2]


def test_a_notch_is_the_bilinear_filter_of_its_transfer_function_prewarped():
    frequency, width, depth = 120.0, 0.6, 0.05
    w = 2 * np.pi * frequency
    stretched = 2.0 / T * np.tan(w * T / 2) / w  # the warped frequency axis, so that cont2discrete's rule meets the notch's center
    num, den = notch(frequency * stretched, width, depth)
    b, a, _ = cont2discrete((num, den), T, "bilinear")
    error = errors(1)
    law = PI(1.0, 0.0, T, -1e9, 1e9, filters=Filters(notch_frequency=(frequency,), notch_width=(width,), notch_depth=(depth,)))
    np.testing.assert_allclose(feedback(law, error), lfilter(b[0], a, error, axis=0), rtol=1e-9, atol=1e-12)


@given(st.floats(1.0, 480.0), st.floats(0.01, 2.0), st.floats(0.0, 1.0))
def test_a_notch_has_its_depth_at_its_frequency_and_passes_what_rests(frequency, width, depth):
    (section,) = Filters(notch_frequency=(frequency,), notch_width=(width,), notch_depth=(depth,)).notches(T)
    center, rest = response(section, np.exp(2j * np.pi * np.array([frequency, 1e-9]) * T))
    assert abs(center) == pytest.approx(depth, abs=1e-6)
    assert rest == pytest.approx(1.0, abs=1e-5)


def test_derivative_and_damping_follow_their_transfer_functions():
    """Up to a twentieth of the sample rate within 4 % and the half sample that a backward difference is late."""
    frequency = np.array([1.0, 5.0, 20.0, 50.0])
    z, s = np.exp(2j * np.pi * frequency * T), 2 * np.pi * frequency
    derivative, damping = ALL.beside(T)
    for section, num, den in (
        (derivative, [0.002, 0.0], [1 / (2 * np.pi * 150.0), 1.0]),
        (damping, [-0.4], [1 / (2 * np.pi * 30.0), 1.0]),
    ):
        _, wanted = freqs(num, den, s)
        late = {derivative: 0.0, damping: -0.5}[section]
        np.testing.assert_allclose(response(section, z) * np.exp(1j * s * T * late), wanted, rtol=0.05)
        _, found = freqz(section[:3], [1.0, *section[3:]], 2 * np.pi * frequency * T)
        np.testing.assert_allclose(response(section, z), found, rtol=1e-12)


def test_all_together_are_the_sum_that_the_module_states():
    error = errors(2)
    passed = error
    for frequency, width, depth in zip(*(getattr(ALL, f"notch_{name}") for name in ("frequency", "width", "depth"))):
        (section,) = Filters(notch_frequency=(frequency,), notch_width=(width,), notch_depth=(depth,)).notches(T)
        passed = lfilter(section[:3], [1.0, *section[3:]], passed, axis=0)
    pole = np.exp(-2 * np.pi * 90.0 * T)
    passed = lfilter([1.0 - pole], [1.0, -pole], passed, axis=0)
    beside = sum(lfilter(section[:3], [1.0, *section[3:]], passed, axis=0) for section in ALL.beside(T))
    expected = 2.0 * passed + 30.0 * T * np.cumsum(passed, axis=0) + beside
    found = feedback(PI(2.0, 30.0, T, -1e9, 1e9, roll_off=90.0, filters=ALL), error)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


@given(st.integers(0, 10**6), st.lists(st.integers(1, 9), min_size=1, max_size=8))
def test_any_cutting_gives_the_same_bits(seed, cuts):
    error, law = errors(seed, sum(cuts)), PI(3.0, 200.0, T, -1.0, 1.5, 400.0, filters=ALL)
    whole, cut = feedback(law, error), law.start(2)
    zero = np.zeros_like(error)
    edges = np.cumsum([0, *cuts])
    parts = [cut.step(error[a:b], zero[a:b], zero[a:b])[1] for a, b in zip(edges, edges[1:])]
    np.testing.assert_array_equal(np.concatenate(parts), whole)


@pytest.mark.parametrize("roll_off", [0.0, 90.0])
def test_resume_continues_from_the_given_command_and_rests_there(roll_off):
    running = PI(5.0, 1e-9, T, -10.0, 10.0, filters=ALL, roll_off=roll_off).start(2)
    one, zero = np.array([0.3, -0.2]), np.zeros(2)
    running.step(errors(3), errors(4), errors(5))
    running.resume(np.array([1.25, -2.0]), one, zero, zero)
    for _ in range(50):
        np.testing.assert_allclose(running.step(one, zero, zero)[0], [1.25, -2.0], atol=1e-9)


def test_a_live_change_of_gains_is_bumpless_behind_a_notch():
    before, after = PI(5.0, 100.0, T, -1e3, 1e3, filters=ALL), PI(1.0, 100.0, T, -1e3, 1e3, filters=ALL)
    kept, changed = before.start(2), before.start(2)
    error, zero = errors(6), np.zeros((60, 2))
    for running in (kept, changed):
        running.step(error, zero, zero)
    changed.change(after)
    one = np.ones((1, 2))
    np.testing.assert_allclose(changed.step(one, zero[:1], zero[:1])[0], kept.step(one, zero[:1], zero[:1])[0], atol=1e-9)


def test_numbers_too_large_leave_the_filters_as_they_were():
    law = PI(5.0, 100.0, T, -1e3, 1e3, filters=ALL)
    spared, hit = law.start(1), law.start(1)
    error, zero = errors(7)[:, :1], np.zeros((60, 1))
    for running in (spared, hit):
        running.step(error, zero, zero)
    for wrong in (1.7e308, np.nan, -np.inf):
        command, _ = hit.step(np.array([wrong]), np.zeros(1), np.zeros(1))
        assert hit.overflowed == (0,) and np.isfinite(command).all()
    np.testing.assert_array_equal(hit.step(error, zero, zero)[0], spared.step(error, zero, zero)[0])


@pytest.mark.parametrize(
    "change",
    [
        {"kd": -1.0},
        {"notch_frequency": (np.nan,)},
        {"notch_frequency": (600.0,)},
        {"notch_width": (0.5, 0.5)},
        {"notch_width": (0.0,)},
        {"damping_corner": 0.0},
    ],
)
def test_senseless_values_are_refused_by_name(change):
    with pytest.raises(InputError, match=next(iter(change))):
        PI(
            1.0,
            1.0,
            T,
            0.0,
            5.0,
            filters=Filters(**{"notch_frequency": (60.0,), "damping_gain": 1.0, "damping_corner": 3.0, **change}),
        )
