# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Play operators and Prandtl-Ishlinskii models against the equations written out, and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyst_control.base.errors import InputError
from hyst_control.chain import Sampling
from hyst_control.chain.hysteresis.prandtl_ishlinskii import ModifiedPrandtlIshlinskii, PlayOperator, PrandtlIshlinskii
from hyst_control.chain.hysteresis.rate_dependent_prandtl_ishlinskii import RateDependentPrandtlIshlinskii

TS = 1e-3
THRESHOLDS, WEIGHTS, W0 = [0.5, 5.5, 22.0], [0.58, 0.28, 0.4], 0.3
MODELS = {
    "two-sided": PrandtlIshlinskii(THRESHOLDS, WEIGHTS, W0),
    "one-sided": PrandtlIshlinskii(THRESHOLDS, WEIGHTS, W0, one_sided=True),
}
voltages = st.lists(st.floats(0.0, 100.0), min_size=1, max_size=40)


def run(stage, u) -> np.ndarray:
    """Output (N,) for a command (N,) from the virgin state at 0 V."""
    running = stage.filter(Sampling(TS, 1))
    running.settle(np.zeros(1))
    return running.process(np.array(u, dtype=float).reshape(-1, 1))[:, 0]


def written_out(u, thresholds, weights, w0=0.0, m1=0.0, m2=0.0, k=0.0, b=0.0, one_sided=False, beta=0.0, levels=None, center=0.0):
    """HAMPI paper Eq. 2-6, sample by sample and operator by operator; beta widens the thresholds with the rate, levels are beside it."""
    h, previous, y = [0.0] * len(thresholds), 0.0, []
    for value in u:
        rate = (value - previous) / TS
        previous = value
        for i, r in enumerate(thresholds):
            r = r + beta * abs(rate)
            h[i] = max(value - r, min(value + (0.0 if one_sided else r), h[i]))
        rotation = -m1 * rate if rate >= 0 else m2 * rate
        own = [w + turn * (value - center) for w, turn in zip(weights, levels or [0.0] * len(weights))]
        y.append(w0 * value + sum((w + rotation + k * value + b) * hi for w, hi in zip(own, h)))
    return np.array(y)


@settings(max_examples=50, deadline=None)
@given(u=voltages, one_sided=st.booleans())
def test_the_models_are_the_papers_equations(u, one_sided):
    expected = written_out(u, THRESHOLDS, WEIGHTS, W0, one_sided=one_sided)
    np.testing.assert_allclose(run(PrandtlIshlinskii(THRESHOLDS, WEIGHTS, W0, one_sided), u), expected, rtol=1e-12, atol=1e-12)
    dynamic = {"m1": 7.7e-7, "m2": 2.5e-7, "k": -6.4e-4, "b": 0.025, "w0": 0.1}
    leveled = {"levels": [1e-3 * (-1) ** i for i in range(len(THRESHOLDS))], "center": 4.0}
    for values in (dynamic, dynamic | leveled):
        expected = written_out(u, THRESHOLDS, WEIGHTS, one_sided=one_sided, **values)
        stage = ModifiedPrandtlIshlinskii(THRESHOLDS, WEIGHTS, one_sided=one_sided, **values)
        np.testing.assert_allclose(run(stage, u), expected, rtol=1e-12, atol=1e-12)
    expected = written_out(u, THRESHOLDS, WEIGHTS, W0, beta=2e-5)
    np.testing.assert_allclose(
        run(RateDependentPrandtlIshlinskii(THRESHOLDS, WEIGHTS, 2e-5, W0), u), expected, rtol=1e-12, atol=1e-12
    )


@given(u=voltages)
@settings(max_examples=30, deadline=None)
def test_without_dynamic_weights_the_modified_model_is_the_classical_one(u):
    np.testing.assert_array_equal(
        run(ModifiedPrandtlIshlinskii(THRESHOLDS, WEIGHTS, w0=W0), u), run(PrandtlIshlinskii(THRESHOLDS, WEIGHTS, W0), u)
    )
    np.testing.assert_allclose(
        run(RateDependentPrandtlIshlinskii(THRESHOLDS, WEIGHTS, 0.0, W0), u),
        run(PrandtlIshlinskii(THRESHOLDS, WEIGHTS, W0), u),
        rtol=1e-14,
    )


@pytest.mark.parametrize("r, amplitude", [(2.0, 10.0), (7.5, 10.0), (12.0, 10.0)])
def test_the_loop_area_of_a_play_operator(r, amplitude):
    """A parallelogram of height 2 (A - r) and horizontal width 2 r: 4 r (A - r), none below the threshold."""
    u = amplitude * np.sin(np.linspace(0, 4 * np.pi, 8001))
    y = run(PlayOperator(r), u)[4000:]
    loop = u[4000:]
    area = 0.5 * abs(np.sum(loop[:-1] * y[1:] - loop[1:] * y[:-1]))
    np.testing.assert_allclose(area, max(4 * r * (amplitude - r), 0.0), rtol=1e-4, atol=1e-9)


@pytest.mark.parametrize("name", MODELS)
def test_the_initial_loading_curve(name):
    """From rest y = w0 u + Σ w_i max(u - r_i, 0): straight pieces whose slope grows by w_i at r_i."""
    u = np.linspace(0, 60, 301)
    expected = W0 * u + sum(w * np.maximum(u - r, 0.0) for r, w in zip(THRESHOLDS, WEIGHTS))
    np.testing.assert_allclose(run(MODELS[name], u), expected, rtol=1e-12)


def test_a_one_sided_operator_gives_back_everything_at_zero():
    """A two-sided one keeps w r at 0 V, a one-sided one nothing."""
    u = [0.0, 50.0, 0.0]
    assert run(PlayOperator(3.0), u)[-1] == 3.0
    assert run(PlayOperator(3.0, one_sided=True), u)[-1] == 0.0


@pytest.mark.parametrize("name", MODELS)
@settings(max_examples=40, deadline=None)
@given(before=voltages, inner=voltages, low=st.floats(0, 45), high=st.floats(55, 100))
def test_a_larger_excursion_wipes_out_inner_loops(name, before, inner, low, high):
    """After low → high (past every earlier extreme), what happened before is forgotten."""
    inside = [low + (high - low) * value / 100.0 for value in inner]
    bounded = [low + (high - low) * value / 100.0 for value in before]
    one = run(MODELS[name], [high, low, high, *inside, high, 50.0])
    other = run(MODELS[name], [*bounded, high, low, high, high, 50.0])
    np.testing.assert_allclose(one[-2:], other[-2:], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("name", MODELS)
@settings(max_examples=40, deadline=None)
@given(start=voltages, low=st.floats(0, 100), high=st.floats(0, 100))
def test_return_point_memory(name, start, low, high):
    """An inner cycle closes on itself: after the first excursion every further one repeats it."""
    again = run(MODELS[name], [*start, low, high, low, high, low, high])
    np.testing.assert_allclose(again[-2:], again[-4:-2], rtol=1e-12, atol=1e-12)


@given(u=voltages, one_sided=st.booleans())
@settings(max_examples=30, deadline=None)
def test_the_output_does_not_depend_on_the_rate(u, one_sided):
    stage = PrandtlIshlinskii(THRESHOLDS, WEIGHTS, W0, one_sided)
    slowed = np.interp(np.arange(0, len(u) - 0.9, 0.25), np.arange(len(u)), u)
    np.testing.assert_allclose(run(stage, slowed)[::4], run(stage, u), rtol=1e-11, atol=1e-11)


@pytest.mark.parametrize(
    "make, word",
    [
        (lambda: PrandtlIshlinskii([1.0, 1.0], [1.0, 1.0]), "thresholds: 1 V is followed by 1 V"),
        (lambda: PrandtlIshlinskii([-1.0, 1.0], [1.0, 1.0]), "thresholds: must be a number >= 0 V, got -1"),
        (lambda: PrandtlIshlinskii([1.0, 2.0], [1.0]), "weights: 1 weights for 2"),
        (lambda: PrandtlIshlinskii([[1.0], [2.0, 1.0]], [[1.0], [1.0, 2.0]]), "axis 1"),
        (lambda: PrandtlIshlinskii([], []), "thresholds: is empty"),
        (lambda: PrandtlIshlinskii([float("nan")], [1.0]), "thresholds: must be a finite number >= 0 V, got nan"),
        (lambda: PlayOperator(-1.0), "threshold: must be a number >= 0 input unit, got -1"),
        (lambda: RateDependentPrandtlIshlinskii([1.0], [1.0], beta=-1.0), "beta"),
        (
            lambda: ModifiedPrandtlIshlinskii([1.0], [1.0], m1=float("inf")),
            "m1: must be a finite number in output unit s / V², got inf",
        ),
    ],
)
def test_operators_that_make_no_sense_are_refused_by_name(make, word):
    with pytest.raises(InputError, match=word):
        make()
