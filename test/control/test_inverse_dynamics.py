# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Approximate inverses of linear dynamics against the HAMPI paper's equations and their defining properties."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy import signal

from hyst_control.base.errors import InputError
from hyst_control.chain import Chain, Sampling
from hyst_control.chain.linear.linear_stages import Delay, StateSpace, TransferFunction
from hyst_control.control.feedforward.inverse_dynamics import (
    METHODS,
    DiscreteSystem,
    invert_dynamics,
    invert_system,
    sampled_systems,
    tustin_systems,
    zero_phase_low_pass,
)

FAST_PART = TransferFunction([-340.48, 340.48 * 1.249e4], [1.0, 8602.0, 5.982e7])  # Eq. 7 without the slow pole-zero pair
EQUATION_7 = TransferFunction([-340.48, 4249823.6928, 34616124.928], [1.0, 8609.942, 59888317.084, 475090440.0])
PAPER_SAMPLE_TIME = 5e-5  # what Eq. 9 was computed with, whatever the text says


def points(frequencies: np.ndarray, sample_time: float) -> np.ndarray:
    return np.exp(2j * np.pi * frequencies * sample_time)


def test_tustin_gives_equation_9():
    plant = tustin_systems([FAST_PART], Sampling(PAPER_SAMPLE_TIME, 1))[0]
    assert plant.gain == pytest.approx(-0.0047, abs=5e-5)
    np.testing.assert_allclose(np.sort(plant.zeros.real), [-1.0, 1.908], atol=5e-4)
    np.testing.assert_allclose(np.poly(plant.poles).real, [1.0, -1.537, 0.6566], atol=5e-4)


def test_zpetc_gives_equation_11():
    """(1.908 z^4 - 2.025 z^3 - 1.143 z^2 + 2.133 z - 0.657) / (0.0155 z^4), after two samples of delay."""
    inverse, preview = invert_system(tustin_systems([FAST_PART], Sampling(PAPER_SAMPLE_TIME, 1))[0], "zpetc")
    assert preview == 2
    numerator = np.poly(inverse.zeros).real * inverse.gain
    np.testing.assert_allclose(numerator * 0.0155, [1.908, -2.025, -1.143, 2.133, -0.657], rtol=0.006, atol=0.002)
    np.testing.assert_allclose(inverse.poles, np.zeros(4))


def test_tustin_of_equation_11_gives_equation_12():
    inverse, _ = invert_system(tustin_systems([FAST_PART], Sampling(PAPER_SAMPLE_TIME, 1))[0], "zpetc")
    s = 2j * np.pi * np.array([10.0, 100.0, 500.0, 3000.0])
    z = (1 + s * PAPER_SAMPLE_TIME / 2) / (1 - s * PAPER_SAMPLE_TIME / 2)
    published = np.polyval([2.594e-2, 4.818e7, 1.016e12, 8.062e15, 3.593e19], s) / np.polyval(
        [1.0, 1.6e5, 9.6e9, 2.56e14, 2.56e18], s
    )
    # Rounding of the printed digits, -0.0047 first of all, leaves up to 2 %.
    np.testing.assert_allclose(inverse.response(z), published, rtol=0.02)


@pytest.mark.parametrize("sample_time", [2e-5, 5e-5, 1e-4, 2e-4])
@pytest.mark.parametrize("delay", [0.0, 6.8e-5, 3.3e-4])
def test_exact_sampling_agrees_with_scipy(sample_time, delay):
    """Zeros, poles and gain of the held system against scipy's zoh and an explicit whole-sample delay."""
    whole = round(delay / sample_time) * sample_time
    plant = sampled_systems([EQUATION_7, Delay(whole)], Sampling(sample_time, 1))[0]
    num, den, _ = signal.cont2discrete((EQUATION_7.num, EQUATION_7.den), sample_time, "zoh")
    z = points(np.array([0.1, 10.0, 300.0, 0.4 / sample_time]), sample_time)
    expected = np.polyval(num.ravel(), z) / np.polyval(den, z) * z ** -round(whole / sample_time)
    np.testing.assert_allclose(plant.response(z), expected, rtol=1e-7)


@pytest.mark.parametrize("delay", [0.0, 1.3e-5, 6.8e-5, 2.5e-4])
@pytest.mark.parametrize("sample_time", [2e-5, 2e-4])
def test_zpetc_has_no_phase_error_and_unit_gain_at_rest(sample_time, delay):
    plant = sampled_systems([Delay(delay), EQUATION_7], Sampling(sample_time, 1))[0]
    inverse, preview = invert_system(plant, "zpetc")
    z = points(np.array([1e-3, 1.0, 50.0, 0.1 / sample_time, 0.37 / sample_time]), sample_time)
    whole = plant.response(z) * inverse.response(z) * z**preview
    np.testing.assert_allclose(whole.imag, 0.0, atol=1e-9 * np.abs(whole).max())
    assert np.all(whole.real > 0.0)
    assert whole[0].real == pytest.approx(1.0, abs=1e-6)


def test_gain_that_is_restored_errs_by_the_square():
    """Zeros on the left, of which H = |B|² / B(1)² stays below 2: with H (2 - H) in place of H, and no phase either way."""
    plant = DiscreteSystem(np.array([-1.3, 0.95 * np.exp(2.5j), 0.95 * np.exp(-2.5j)]), np.array([0.2, 0.3, 0.1, 0.4]), 0.5)
    z = np.exp(1j * np.linspace(0.01, 3.0, 40))
    bare, restored = (
        plant.response(z) * inverse.response(z) * z**preview
        for inverse, preview in (invert_system(plant, "zpetc"), invert_system(plant, "zpetc", restored=True))
    )
    assert np.abs(bare.imag).max() < 1e-9 and np.abs(restored.imag).max() < 1e-8
    np.testing.assert_allclose(1.0 - restored.real, (1.0 - bare.real) ** 2, atol=1e-8)


def test_gain_of_zeros_on_the_right_is_left_as_it_is():
    """A zero at 1.5 makes H grow up to 25, where 2 - H would turn the reference around."""
    plant = DiscreteSystem(np.array([1.5 + 0j]), np.array([0.2, 0.3]), 0.5)
    bare, restored = invert_system(plant, "zpetc"), invert_system(plant, "zpetc", restored=True)
    assert bare[1] == restored[1] and np.array_equal(bare[0].zeros, restored[0].zeros)


@pytest.mark.parametrize("sample_time", [2e-5, 5e-5])
def test_zmetc_has_no_magnitude_error(sample_time):
    plant = sampled_systems([EQUATION_7], Sampling(sample_time, 1))[0]
    inverse, preview = invert_system(plant, "zmetc")
    z = points(np.array([1.0, 50.0, 500.0, 0.2 / sample_time, 0.45 / sample_time]), sample_time)
    np.testing.assert_allclose(np.abs(plant.response(z) * inverse.response(z)), 1.0, rtol=1e-9)


def test_order_of_the_methods_in_figure_8():
    """Fig. 8: over 10-500 Hz ZPETC has the least phase error, ZMETC the least magnitude error, NPZ-ignore half of ZMETC's phase."""
    sampling = Sampling(PAPER_SAMPLE_TIME, 1)
    plant = tustin_systems([FAST_PART], sampling)[0]
    z = points(np.linspace(10.0, 500.0, 50), PAPER_SAMPLE_TIME)
    phase, magnitude = {}, {}
    for method in METHODS:
        inverse, preview = invert_system(plant, method)
        whole = plant.response(z) * inverse.response(z) * z**preview
        phase[method], magnitude[method] = np.abs(np.angle(whole)).max(), np.abs(np.abs(whole) - 1).max()
    assert phase["zpetc"] < 1e-9 < phase["npz_ignore"] < phase["zmetc"]
    assert magnitude["zmetc"] < magnitude["npz_ignore"] < magnitude["zpetc"]


@st.composite
def stable_systems(draw):
    """Stable proper systems of order 1-4 with zeros anywhere but on the imaginary axis."""
    sign = draw(st.sampled_from([1.0, -1.0]))
    poles, zeros = [], []
    for _ in range(draw(st.integers(1, 2))):
        w, zeta = draw(st.floats(200.0, 2e4)), draw(st.floats(0.05, 1.5))
        poles += list(np.roots([1.0, 2 * zeta * w, w * w])) if draw(st.booleans()) else [-w]
    for _ in range(draw(st.integers(0, len(poles)))):
        zeros.append(draw(st.floats(100.0, 5e4)) * draw(st.sampled_from([-1.0, 1.0])))
    den = np.poly(poles).real
    num = np.atleast_1d(np.poly(zeros).real)
    return TransferFunction(list(sign * 0.1 * num * den[-1] / num[-1]), list(den))


@settings(max_examples=60, deadline=None)
@given(
    system=stable_systems(),
    sample_time=st.sampled_from([2e-5, 1e-4, 3e-4]),
    delay=st.just(0.0) | st.floats(1e-8, 5e-4),
    method=st.sampled_from(METHODS),
)
def test_inverse_of_any_stable_system_is_stable_and_tracks_slow_references(system, sample_time, delay, method):
    sampling = Sampling(sample_time, 1)
    plant = sampled_systems([Delay(delay), system], sampling)[0]
    assume(np.all(np.abs(plant.zeros - 1.0) > 1e-3))
    inverse, preview = invert_system(plant, method)
    assert np.all(np.abs(inverse.poles) < 1.0)
    z = points(np.array([1e-4 / sample_time]), sample_time)
    # Every zero and pole adds its own error, 2 sin(angle) / |1 - root| at most, where the angle is 2 pi 1e-4.
    slowness = np.abs(np.concatenate([1 / (1 - plant.zeros), 1 / (1 - plant.poles)])).sum()
    assert abs(plant.response(z) * inverse.response(z) * z**preview - 1.0)[0] < 2e-3 * max(slowness, 1.0)


def separation(roots):
    """Smallest distance between two of the roots."""
    distances = np.abs(np.subtract.outer(roots, roots)) + np.diag(np.full(len(roots), np.inf))
    return distances.min(initial=np.inf)


@settings(max_examples=40, deadline=None)
@given(
    system=stable_systems(),
    sample_time=st.sampled_from([2e-5, 1e-4]),
    delay=st.just(0.0) | st.floats(1e-8, 2e-4),
    method=st.sampled_from(METHODS),
    frequency=st.floats(0.001, 0.3),
)
def test_stage_in_series_with_the_plant_answers_as_the_polynomials_say(system, sample_time, delay, method, frequency):
    """Run the inverse and the held plant as filters and compare with |G Ginv| at one frequency, in the time domain."""
    sampling = Sampling(sample_time, 1)
    plant = sampled_systems([Delay(delay), system], sampling)[0]
    assume(np.all(np.abs(plant.zeros - 1.0) > 0.02) and np.all(np.abs(plant.poles) < 0.98))
    # Roots of a polynomial that lie close to each other are known to a fraction of the precision only.
    assume(separation(plant.zeros) > 0.01 and separation(plant.poles) > 0.01)
    inverse = invert_dynamics([Delay(delay), system], sampling, method)
    assume(np.all(np.abs(inverse.systems[0].poles) < 0.98))
    n = np.arange(3000)
    feed = np.cos(2 * np.pi * frequency * n)[:, None]
    first = Chain(inverse.stages).filter(Sampling(sample_time, 1, "foh"))
    second = Chain((Delay(delay), system)).filter(sampling)
    first.settle(feed[0])
    start = second.settle(first.settle(feed[0]))
    command = first.process(feed)
    output = np.concatenate([start[None], second.process(command)[:-1]])[:, 0]
    z = np.exp(2j * np.pi * frequency)
    expected = (plant.response(z) * inverse.systems[0].response(z) * z**n).real
    np.testing.assert_allclose(output[2000:], expected[2000:], atol=1e-6 * max(1.0, np.abs(command).max()))


def test_axes_share_the_longest_preview():
    slow = TransferFunction([[1e4], [1e4]], [[1.0, 1e4], [1.0, 1e4]])
    inverse = invert_dynamics([Delay([0.0, 3.2e-4]), slow], Sampling(1e-4, 2))
    alone = invert_dynamics([Delay(3.2e-4), TransferFunction([1e4], [1.0, 1e4])], Sampling(1e-4, 1))
    assert inverse.preview == alone.preview
    running = Chain(inverse.stages).filter(Sampling(1e-4, 2, "foh"))
    running.settle(np.zeros(2))
    step = running.process(np.concatenate([np.zeros((1, 2)), np.ones((20, 2))]))
    first = [int(np.flatnonzero(step[:, axis])[0]) for axis in range(2)]
    assert first[0] > first[1], "the axis without delay waits for the other one"


def test_a_delay_of_many_samples_takes_no_states_and_is_made_up_for():
    """An inverse of an axis that is late by 503 samples, beside one that is not: both answer to the reference at the same tick."""
    mode = TransferFunction([1e6], [1.0, 600.0, 1e6])
    inverse = invert_dynamics([Delay([0.0503, 1e-4]), mode], Sampling(1e-4, 2))
    states = sum(len(stage.A) for stage in inverse.stages if isinstance(stage, StateSpace))
    assert inverse.preview > 503 and states <= 2 * 6
    n = np.arange(3000)
    reference = np.repeat((1.0 - np.cos(2 * np.pi * n / 500))[:, None], 2, axis=1)
    command = Chain(inverse.stages).filter(Sampling(1e-4, 2, "foh"))
    plant = Chain((Delay([0.0503, 1e-4]), mode)).filter(Sampling(1e-4, 2))
    command.settle(reference[0])
    plant.settle(reference[0])
    measurement = plant.process(command.process(reference))  # at the ticks after the commands
    ahead = inverse.preview - 1
    np.testing.assert_allclose(measurement[ahead + 500 :], reference[500 : len(n) - ahead], atol=2e-4)


@pytest.mark.parametrize(
    ("system", "word"),
    [
        (TransferFunction([1.0], [1.0, -5.0]), "stable"),
        (TransferFunction([1.0, 0.0], [1.0, 5.0]), "static gain"),
        (TransferFunction([[[1.0], [0.1]], [[0.1], [1.0]]], [1.0, 5.0], coupled=True), "mix the axes"),
    ],
)
def test_what_has_no_inverse_is_refused(system, word):
    with pytest.raises(InputError, match=word):
        invert_dynamics([system], Sampling(1e-4, 2 if system.coupled else 1))


@pytest.mark.parametrize("order", [1, 2, 5])
def test_zero_phase_low_pass_has_the_gain_it_states_and_no_phase(order):
    """Sines through the running stage, both axes: 1 - ((1 - cos w) / 2)^order, `order` samples late; constants and ramps untouched."""
    running = Chain((zero_phase_low_pass(order, 2, 1e-3),)).filter(Sampling(1e-3, 2, "foh"))
    k = np.arange(400)
    for w in 2 * np.pi * np.array([0.02, 0.2, 0.35, 0.5]):
        signal_ = np.stack([np.cos(w * k), 3.0 * np.cos(w * k + 0.4)], axis=1)
        running.settle(signal_[0])
        passed = running.process(signal_)[2 * order :]
        expected = (1.0 - ((1.0 - np.cos(w)) / 2.0) ** order) * signal_[order:-order]
        np.testing.assert_allclose(passed, expected, atol=1e-12)
    ramp = np.stack([k, 5.0 - 2.0 * k], axis=1).astype(float)
    np.testing.assert_allclose(running.settle(ramp[0]), ramp[0], atol=1e-12)
    np.testing.assert_allclose(running.process(ramp)[2 * order :], ramp[order:-order], atol=1e-9)
