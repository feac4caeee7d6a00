# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Feedback-error learning: what it converges to in closed form, that it stands still at rest, and that its bounds hold."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hyst_control.base.errors import InputError
from hyst_control.chain import Chain
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.control.feedback.loop import run_loop
from hyst_control.control.feedback.pi import PI
from hyst_control.control.feedforward.compensator import build_compensator
from hyst_control.control.feedforward.static_gain import Proportional
from hyst_control.control.learning.feedback_error_learning import FeedbackErrorLearning
from hyst_control.control.learning.learning_loop import run_learning_loop
from hyst_control.control.tuning import tune
from hyst_control.model_file import Model, Simulator, load_model
from hyst_plant_sim.physics import load_plant

MHL = load_model(Path(__file__).resolve().parents[2] / "config" / "models" / "fsm_mhl.yaml")
TS = 1e-3


def plant(*stages) -> Simulator:
    return Simulator(Model(name="m", axes=("x",), units={"command": "V", "measurement": "um"}, sample_time=TS, chain=Chain(stages)))


@pytest.mark.parametrize(("gain", "lag"), [(1.1, 0.0), (0.9, 0.0), (1.0, 4e-3), (1.1, 4e-3)])
def test_it_finds_gain_and_lag_of_a_linear_plant(gain, lag):
    """For y = g / (lag s + 1) u the command (r + lag r') / g is due: gain -> 1 / g - 1, and lag -> lag / g, one sample beside."""
    description = FeedbackErrorLearning(TS, time=0.2, corner=0.5, lag_bound=0.02)
    learner = description.start(1)
    time = np.arange(8000) * TS
    reference = (10.0 + 5.0 * np.sin(2 * np.pi * 3.0 * time) + 2.0 * np.sin(2 * np.pi * 7.1 * time))[:, None]
    controller = PI(0.3, 40.0, TS, -1e3, 1e3).start(1)
    stage = TransferFunction([gain], [lag, 1.0]) if lag else TransferFunction([gain], [1.0])
    run_learning_loop(reference, Proportional(np.ones(1), np.zeros(1)), controller, plant(stage), learner)
    assert learner.gain[0] == pytest.approx(1.0 / gain - 1.0, abs=0.01)
    # The sample comes one tick after its command; half of it is the held command's.
    assert learner.lag[0] == pytest.approx((lag + TS) / gain, abs=0.6 * TS)


def test_it_follows_a_drift_on_the_truth_mirror():
    """Gain +10 %: most of what the drift adds to the error at 100 Hz is gone after two seconds."""
    ts = 2e-4
    tuning = tune(MHL, sample_time=ts, roll_off=800.0)
    reference = np.repeat((1.0 - 0.9 * np.cos(200 * np.pi * np.arange(10000) * ts))[:, None], 2, axis=1)

    def errors(gain: float, learner=None) -> float:
        truth = load_plant({"plant": "fsm", "effects": [{"name": "gain", "gain": gain}] if gain else []}, seed=3, sample_time=ts)
        compensator = build_compensator(MHL, "mhl_inverse", sample_time=ts, limits=(0.0, 100.0))
        parts = reference, compensator, tuning.controller(0.0, 100.0, 1e6).start(2), truth
        signals = run_learning_loop(*parts, learner) if learner else run_loop(*parts)
        return float(np.sqrt(np.mean((signals["reference"] - signals["measurement"])[-1000:] ** 2)))

    learner = FeedbackErrorLearning(ts).start(2)
    nominal, drifted, learned = errors(0.0), errors(0.1), errors(0.1, learner)
    assert drifted > 1.2 * nominal
    assert learned < nominal + 0.2 * (drifted - nominal)
    assert np.all(learner.gain < -0.02)


def test_a_constant_reference_for_hours_moves_nothing():
    """Three hours at 1 kHz of a feedback that drifts and is noisy, after some motion: not one bit."""
    rng, learner = np.random.default_rng(5), FeedbackErrorLearning(TS).start(1)
    time = np.arange(5000)[:, None] * TS
    moving = 20.0 + 10.0 * np.sin(2 * np.pi * 5.0 * time)
    learner.learned(0, moving)
    learner.observe(0, moving, moving, 0.05 * moving)
    rows = np.full((8000, 1), 20.0)
    first, tick = None, 5000
    for block in range(3 * 3600 * 1000 // len(rows)):
        feedback = 1e-3 * block + rng.standard_normal(rows.shape)
        learner.learned(tick, rows)
        learner.observe(tick, rows, rows, feedback)
        tick += len(rows)
        if tick * TS >= 15.0 and first is None:
            first = np.concatenate([learner.gain, learner.lag])
            assert np.all(first != 0.0)
    np.testing.assert_array_equal(np.concatenate([learner.gain, learner.lag]), first)


@settings(deadline=None)
@given(
    st.lists(
        st.floats(allow_nan=True, allow_infinity=True, width=64) | st.sampled_from([1e300, -1e300, 0.0]), min_size=1, max_size=60
    ),
    st.integers(0, 10**6),
)
@example([1.797693124862316e308, -1e300, 0.0], 0)
def test_wild_feedback_never_leaves_the_bounds(wild, seed):
    learner = FeedbackErrorLearning(TS, time=0.01, gain_bound=0.2, lag_bound=1e-3).start(1)
    feedforward = np.cumsum(np.random.default_rng(seed).standard_normal((len(wild), 1)), axis=0) * 10
    for tick, value in enumerate(wild):
        added = learner.learned(tick, feedforward[tick : tick + 1])
        with np.errstate(all="ignore"):
            learner.observe(tick, np.zeros((1, 1)), np.zeros((1, 1)), np.full((1, 1), value))
        assert np.isfinite(added).all()
        assert abs(learner.gain[0]) <= 0.2 and abs(learner.lag[0]) <= 1e-3


@settings(deadline=None)
@given(st.integers(0, 10**6), st.lists(st.integers(1, 12), min_size=1, max_size=12))
def test_any_cutting_of_a_record_gives_the_same_bits(seed, cuts):
    rng, count = np.random.default_rng(seed), sum(cuts)
    feedforward, feedback = 10 * rng.standard_normal((2, count, 2))
    description = FeedbackErrorLearning(TS, time=0.01)
    one, cut = description.start(2), description.start(2)
    one.learned(0, feedforward)
    one.observe(0, feedback, feedback, feedback)
    edges = np.cumsum([0, *cuts])
    for begin, end in zip(edges[:-1], edges[1:]):
        cut.learned(int(begin), feedforward[begin:end])
        cut.observe(int(begin), *[feedback[begin:end]] * 3)
    np.testing.assert_array_equal(one.gain, cut.gain)
    np.testing.assert_array_equal(one.lag, cut.lag)


def test_without_what_was_learned_nothing_is_added():
    learner = FeedbackErrorLearning(TS).start(2)
    rows = np.random.default_rng(1).standard_normal((50, 2))
    np.testing.assert_array_equal(learner.learned(0, rows), np.zeros((50, 2)))
    assert learner.available(50) == 0  # the next row waits for the feedback
    learner.observe(0, rows, rows, rows)
    assert learner.available(50) == 1


@pytest.mark.parametrize(
    "change", [{"time": 0.0}, {"time": 1e-5}, {"corner": -1.0}, {"excitation": np.nan}, {"gain_bound": 1.0}, {"lag_bound": -1e-3}]
)
def test_senseless_values_are_refused_by_name(change):
    with pytest.raises(InputError, match=next(iter(change))):
        FeedbackErrorLearning(TS, **change)
