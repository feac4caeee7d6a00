# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Learning from trial to trial: convergence on truth plants, the stops, and one result however the rows are cut."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyst_control.base.errors import InputError
from hyst_control.control.feedforward.compensator import build_compensator
from hyst_control.control.learning.iterative_learning import IterativeLearning
from hyst_control.control.learning.learning_filter import LearningFilter, model_filter
from hyst_control.control.learning.learning_loop import run_learning_loop
from hyst_control.control.tuning import tune
from hyst_control.model_file import load_model
from hyst_plant_sim.physics import load_plant

MODELS = Path(__file__).resolve().parents[2] / "config" / "models"
MHL, HAMPI = load_model(MODELS / "fsm_mhl.yaml"), load_model(MODELS / "pea_hampi.yaml")
TS = 2e-4
STROKE = 1.8


@pytest.fixture(scope="module")
def tuning():
    return tune(MHL, sample_time=TS, roll_off=800.0)


def trials(tuning, count: int = 12, effects=(), **parameters):
    """100 Hz over nine tenths of the mirror's range, both axes."""
    wave = 1.0 - 0.5 * STROKE * np.cos(200 * np.pi * np.arange(50) * TS)
    reference = np.tile(np.repeat(wave[:, None], 2, axis=1), (3 * count, 1))
    learner = IterativeLearning(model_filter(MHL, 50, sample_time=TS), trials=count).start()
    run_learning_loop(
        reference,
        build_compensator(MHL, "mhl_inverse", sample_time=TS, limits=(0.0, 100.0)),
        tuning.controller(0.0, 100.0, 1e6).start(2),
        load_plant({"plant": "fsm", "effects": list(effects)}, seed=1, sample_time=TS, **parameters),
        learner,
    )
    return np.array([100.0 * each.error / STROKE for each in learner.history]), learner


def test_truth_mirror_comes_to_its_noise_in_four_trials(tuning):
    error, learner = trials(tuning)
    floor = 100.0 * 0.0003 / STROKE
    assert error[0] > 0.3, "there must be something to learn"
    assert error[4 if len(error) > 4 else -1] <= 0.03 and error.min() < 1.8 * floor
    assert learner.stopped in ("the repeating error is below twice its noise", "nothing gained")


@pytest.mark.parametrize(
    ("changed", "after"),
    [({"effects": [{"name": "gain", "gain": 0.1}]}, 4), ({"mode_frequency": [0.8 * 1930.0, 0.8 * 1965.0]}, 8)],
    ids=["gain +10 %", "mode -20 %"],
)
def test_it_converges_on_a_mirror_that_is_not_the_models(tuning, changed, after):
    """The first mode of the truth stands in a notch that does not move with it: far more than the filter allows for."""
    error, _ = trials(tuning, **changed)
    assert error[: after + 1].min() < 0.15 * error[0]
    assert error[-1] < 0.2 * error[0]


def test_truth_stage_at_150_hz():
    ts, rows = 5e-5, 400
    tuning = tune(HAMPI, sample_time=ts)
    wave = 4.0 - 2.0 * np.cos(2 * np.pi * 150.0 * np.arange(rows) * ts)  # three cycles
    learner = IterativeLearning(model_filter(HAMPI, rows, sample_time=ts), trials=6).start()
    run_learning_loop(
        np.tile(wave[:, None], (18, 1)),
        build_compensator(HAMPI, "hampi", sample_time=ts, limits=(0.0, 150.0)),
        tuning.controller(0.0, 150.0, 2e6).start(1),
        load_plant("pea", seed=2, sample_time=ts),
        learner,
    )
    errors = [each.error for each in learner.history]
    assert min(errors[:5]) < 0.1 * errors[0]


def synthetic(errors, filter_=None, noise: float = 0.0, **options):
    """A learner that is shown these errors (one a trial, times one fixed wave), with noise."""
    filter_ = filter_ or LearningFilter(8, np.ones((5, 1, 1), dtype=complex), np.ones(5))
    wave, rng = np.random.default_rng(0).standard_normal((8, 1)), np.random.default_rng(1)
    learner, used = IterativeLearning(filter_, **options).start(), []
    rows = learner.description.trial_rows
    for index, error in enumerate(errors):
        first = index * rows
        learner.learned(first, np.zeros((rows, 1)))
        used.append(learner.feedforward)
        shown = np.tile(error * wave, (rows // 8, 1)) + noise * rng.standard_normal((rows, 1))
        learner.observe(first, shown, np.zeros((rows, 1)), np.zeros((rows, 1)))
    return learner, used


def test_growing_error_stops_it_at_the_best_feedforward():
    learner, used = synthetic([1.0, 0.5, 0.8, 0.9, 1.1, 1.2, 5.0])
    assert learner.stopped == "error grows" and len(learner.history) == 5
    np.testing.assert_array_equal(learner.feedforward, used[1])


def test_an_error_that_stays_stops_it():
    learner, _ = synthetic([1.0, 0.2, 0.2, 0.199, 0.198, 0.1])
    assert learner.stopped == "nothing gained" and len(learner.history) == 5


def test_noise_alone_stops_it_at_once():
    learner, _ = synthetic([0.0, 0.0], noise=1.0, averaged=4)
    assert learner.stopped == "the repeating error is below twice its noise" and len(learner.history) == 1
    assert learner.history[0].noise == pytest.approx(0.5, rel=0.4)
    assert np.all(learner.feedforward == 0.0)


def test_trials_and_limit_are_kept():
    learner, used = synthetic([1.0, 0.7, 0.4, 0.2], trials=3, limit=0.3)
    assert learner.stopped == "last trial" and len(learner.history) == 3
    assert np.abs(used[-1]).max() <= 0.3


def test_a_filter_of_the_wrong_sign_is_found_out_and_measured_anew():
    """y = u + 2 after one period, learned with 1 / G = -1: the first trial doubles the error, the secant then has the right sign."""
    learner = IterativeLearning(LearningFilter(8, -np.ones((5, 1, 1), dtype=complex), np.ones(5)), trials=6).start()
    wave = np.random.default_rng(3).standard_normal((8, 1))
    for first in range(0, 6 * 24, 24):
        given = learner.learned(first, np.zeros((24, 1)))
        learner.observe(first, np.zeros((24, 1)), given + np.tile(wave, (3, 1)), np.zeros((24, 1)))
    errors = [each.error for each in learner.history]
    assert errors[1] == pytest.approx(2 * errors[0]) and errors[2] < 1e-9 * errors[0]


def test_a_gap_begins_the_trial_anew():
    learner = IterativeLearning(LearningFilter(8, np.ones((5, 1, 1), dtype=complex), np.ones(5))).start()
    one, none = np.ones((10, 1)), np.zeros((10, 1))
    learner.learned(0, none)
    learner.observe(0, one, none, none)
    learner.observe(10, one[:2], none[:2], none[:2])
    learner.observe(14, one, none, none)  # two ticks are missing within the measured periods
    assert not learner.history
    for first in range(24, 40, 2):
        learner.observe(first, one[:2], none[:2], none[:2])
    assert len(learner.history) == 1 and learner.history[0].repeating == 1.0


@settings(deadline=None)
@given(st.integers(0, 10**6), st.lists(st.integers(1, 40), min_size=1, max_size=30))
def test_any_cutting_gives_the_same_bits(seed, cuts):
    """However many rows are given ahead, up to `available`, and however what was observed is cut."""
    filter_ = LearningFilter(8, 0.5 * np.ones((5, 2, 2), dtype=complex) + np.eye(2), np.ones(5))
    rng, count = np.random.default_rng(seed), 96
    reference, measurement, feedback = rng.standard_normal((3, count, 2))
    description = IterativeLearning(filter_, gain=0.7)
    whole, parts = description.start(), description.start()
    expected = []
    for first in range(0, count, 24):
        expected.append(whole.learned(first, np.zeros((24, 2))))
        whole.observe(first, *(rows[first : first + 24] for rows in (reference, measurement, feedback)))
    found, given_rows, seen, turn = [], 0, 0, 0
    while seen < count:
        size = min(cuts[turn % len(cuts)], parts.available(given_rows), count - given_rows)
        if size:
            found.append(parts.learned(given_rows, np.zeros((size, 2))))
            given_rows += size
        step = min(cuts[(turn + 1) % len(cuts)], given_rows - seen)
        parts.observe(seen, *(rows[seen : seen + step] for rows in (reference, measurement, feedback)))
        seen, turn = seen + step, turn + 1
    np.testing.assert_array_equal(np.concatenate(found), np.concatenate(expected))


@pytest.mark.parametrize("change", [{"settling": 0}, {"averaged": 1}, {"gain": 0.0}, {"gain": 1.5}, {"trials": 0}, {"limit": 0.0}])
def test_senseless_values_are_refused_by_name(change):
    with pytest.raises(InputError, match=next(iter(change))):
        IterativeLearning(LearningFilter(8, np.ones((5, 1, 1), dtype=complex), np.ones(5)), **change)
