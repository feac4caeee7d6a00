# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Resonances of a chain and their moves, against closed forms of plants that are built with the mode where it goes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.signal import cont2discrete

from hyst_control.chain import Parallel, Stage
from hyst_control.chain.linear.linear_stages import Delay, StateSpace, TransferFunction
from hyst_control.control.linearization import sampled_response
from hyst_control.control.moving_modes import first_mode, resonances, well_damped, with_modes

STEP = 1e-4
Z = np.exp(2j * np.pi * np.linspace(5.0, 4000.0, 500) * STEP)
Modes = Sequence[tuple[float, float, float]]
"""Frequency (Hz), damping ratio and gain at rest of modes that are added."""
NOSE = [(850.0, 0.02, 0.8), (1300.0, 0.004, 0.2)]
WEAK = [(2200.0, 0.05, 1.0), (700.0, 0.005, 0.005)]


def pole(frequency: float, damping: float) -> complex:
    return 2 * np.pi * frequency * complex(-damping, np.sqrt(1.0 - damping**2))


def fraction(modes: Modes) -> tuple[np.ndarray, np.ndarray]:
    num, den = np.zeros(1), np.ones(1)
    for frequency, damping, gain in modes:
        w = 2 * np.pi * frequency
        own = np.array([1.0, 2 * damping * w, w * w])
        num, den = np.polyadd(np.polymul(num, own), gain * w * w * den), np.polymul(den, own)
    return num, den


def summed(modes: Modes, num: Sequence[float] = (1.0,), den: Sequence[float] = (1.0,)) -> TransferFunction:
    """The sum of modes behind a filter, as one transfer function."""
    above, below = fraction(modes)
    return TransferFunction(np.polymul(above, num).tolist(), np.polymul(below, den).tolist())


def response(*stages: Stage, axes: int = 1) -> np.ndarray:
    return sampled_response(stages, axes, STEP, Z)


def at(modes: Modes, *factors: float) -> list[tuple[float, float, float]]:
    return [(factor * frequency, damping, gain) for (frequency, damping, gain), factor in zip(modes, factors, strict=True)]


@pytest.mark.parametrize("modes", [NOSE, WEAK], ids=["nose", "weak"])
@pytest.mark.parametrize("factor", [0.8, 1.2])
def test_a_mode_of_a_sum_moves_with_its_zeros(modes, factor):
    stage, one = summed(modes), np.array([pole(*modes[1][:2])])
    for only, factors in ((one, (1.0, factor)), (None, (factor, factor))):
        found = response(*with_modes([Delay(1.3e-4), stage], 1, factor, only))
        np.testing.assert_allclose(found, response(Delay(1.3e-4), summed(at(modes, *factors))), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("damping", [0.55, 0.7, 0.9])
@pytest.mark.parametrize("factor", [0.8, 1.2])
def test_a_mode_moves_behind_an_amplifier_and_slow_drift_that_stay(damping, factor):
    """An amplifier of 300 Hz and a nearly canceled pair at 4.4 Hz are no resonances, although their poles are complex and slower."""
    w, slow = 2 * np.pi * 300.0, 2 * np.pi * 4.4
    num, den = [1.0, 1.95 * slow, slow**2], np.polymul([1.0, 1.94 * slow, slow**2], [w**-2, 2 * damping / w, 1.0])
    before, after = (summed(modes, num, den) for modes in (NOSE, at(NOSE, factor, 1.0)))
    np.testing.assert_allclose(resonances([before], 1).poles, [pole(*mode[:2]) for mode in NOSE], rtol=1e-6)
    found = response(*with_modes([before], 1, factor, np.array([pole(*NOSE[0][:2])])))
    np.testing.assert_allclose(found, response(after), rtol=1e-6, atol=1e-9)


def test_a_mode_that_its_zeros_cancel_moves_without_a_trace():
    w, corner = 2 * np.pi * 700.0, 2 * np.pi * 200.0
    own = [w**-2, 0.04 / w, 1.0]
    stage = TransferFunction(own, np.polymul(own, [1.0 / corner, 1.0]))
    np.testing.assert_allclose(
        response(*with_modes([stage], 1, 0.8)), response(TransferFunction([1.0], [1.0 / corner, 1.0])), rtol=1e-6
    )


@pytest.mark.parametrize("damping", [0.0, -0.01])
def test_a_mode_without_damping_is_a_resonance_too(damping):
    assert first_mode([summed([(300.0, damping, 1.0)])], 1) == pytest.approx(pole(300.0, damping))


def test_the_first_mode_is_a_broad_one_where_no_narrow_one_is():
    assert first_mode([summed([(1200.0, 0.56, 1.0)])], 1) == pytest.approx(pole(1200.0, 0.56))
    assert first_mode([summed([(1200.0, 0.56, 1.0), (2000.0, 0.1, 0.1)])], 1) == pytest.approx(pole(2000.0, 0.1))
    assert first_mode([summed([(1200.0, 0.71, 1.0)]), Delay(1e-4)], 1) is None


def test_a_notch_filter_of_its_own_stage_stays():
    w = 2 * np.pi * 850.0
    notch = TransferFunction([1.0, 0.1 * w, w * w], [1.0, 1.6 * w, w * w])
    found = response(*with_modes([notch, summed(NOSE[:1])], 1, 0.9))
    np.testing.assert_allclose(found, response(notch, summed(at(NOSE[:1], 0.9))), rtol=1e-9)


def test_modes_of_branches_and_of_coupled_axes_move():
    inside = Parallel(((summed(NOSE[:1]),), (summed(NOSE[1:]),)))
    np.testing.assert_allclose(response(*with_modes([inside], 1, 0.9)), response(summed(at(NOSE, 0.9, 0.9))), rtol=1e-6, atol=1e-9)

    def coupled(factor: float) -> StateSpace:
        """Two modes at the same place, each of which moves both axes, and a third."""
        parts = [
            (850.0 * factor, [1.0, 0.3], [1.0, 0.2]),
            (850.0 * factor, [0.1, 1.0], [0.2, 1.0]),
            (2000.0, [0.2, 0.1], [1.0, 1.0]),
        ]
        a, b, c = [], [], []
        for frequency, out, entry in parts:
            w = 2 * np.pi * frequency
            a.append([[0.0, 1.0], [-w * w, -0.04 * w]])
            b.append(np.outer([0.0, w * w], entry))
            c.append(np.outer(out, [1.0, 0.0]))
        return StateSpace(block_diag(*a).tolist(), np.vstack(b).tolist(), np.hstack(c).tolist(), np.zeros((2, 2)).tolist())

    found = response(*with_modes([coupled(1.0)], 2, 0.9, np.array([pole(850.0, 0.02)])), axes=2)
    np.testing.assert_allclose(found, response(coupled(0.9), axes=2), rtol=1e-6, atol=1e-9)


def test_a_well_damped_mode_has_the_same_frequency_and_gain_and_no_peak():
    quiet = [(NOSE[0][0], np.sqrt(0.5), NOSE[0][2]), NOSE[1]]
    found = response(*well_damped([summed(NOSE)], 1, np.array([pole(*NOSE[0][:2])])))
    np.testing.assert_allclose(found, response(summed(quiet)), rtol=1e-6, atol=1e-9)


def test_a_mode_of_a_discrete_state_space_moves_in_the_plane_of_z():
    w = 2 * np.pi * 300.0
    parts = np.array([[0.0, 1.0], [-w * w, -0.04 * w]]), np.array([[0.0], [w * w]]), np.array([[1.0, 0.0]]), np.zeros((1, 1))
    a, b, c, d, _ = cont2discrete(parts, STEP)
    stage = StateSpace(a.tolist(), b.tolist(), c.tolist(), d.tolist(), sample_time=STEP)
    assert first_mode([stage], 1) == pytest.approx(pole(300.0, 0.02))
    (moved,) = with_modes([stage], 1, 0.8)
    assert moved.sample_time == STEP
    np.testing.assert_allclose(moved.gain_at_rest(1)[0], 1.0, rtol=1e-9)
    expected = response(summed([(240.0, 0.02, 1.0)]))
    np.testing.assert_allclose(response(moved)[:120], expected[:120], rtol=0.03)
