# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A model's error, learned from features of the command on baseline records, and what it says of commands that it has not seen."""

from __future__ import annotations

import numpy as np
import pytest

from hyst_control.base.errors import InputError
from hyst_control.chain.command_features import CommandFeatures, play
from hyst_control.identify.model_error.learned_discrepancy import LearnedDiscrepancy, discrepancy_of, learn
from hyst_control.records.correlation import correlation_length
from hyst_control.records.session_zero import usual_zero, without_zero

STEP = 1e-3


def loops(frequency: float, amplitude: float = 10.0, seconds: float = 2.0) -> np.ndarray:
    time = STEP * np.arange(int(seconds / STEP))
    return amplitude * np.interp(time, [0.0, seconds], [1.0, 0.3]) * np.sin(2 * np.pi * frequency * time)


def error(command: np.ndarray, seed: int) -> np.ndarray:
    """Memory that no feature is (a play of another width), a part that grows with the rate, noise."""
    rate = np.gradient(command, STEP)
    noise = 0.02 * np.random.default_rng(seed).standard_normal(len(command))
    return 0.2 * (play(command, 2.6) - command) + 2e-3 * rate + 0.01 * command**2 + noise


def left(found: LearnedDiscrepancy, command: np.ndarray, rows: np.ndarray) -> tuple[float, float, float]:
    """Rms of an error before and after the prediction, and as foreseen."""
    design = without_zero(found.features.rows(command, STEP))[0]
    rest = without_zero(rows[:, None])[0][:, 0]
    foreseen = np.hypot(np.sqrt(np.mean(np.sum((design @ found.factor) ** 2, axis=1))), found.rest)
    return float(np.std(rest)), float(np.std(rest - design @ found.mean)), float(foreseen)


def test_an_error_that_follows_the_command_is_predicted_on_a_command_not_seen():
    clean = [loops(2.0), loops(6.0)]
    found = learn(clean, [error(command, seed) for seed, command in enumerate(clean)], STEP)
    assert found is not None
    before, after, foreseen = left(found, loops(4.0), error(loops(4.0), 7))
    assert after < 0.3 * before
    assert after < 1.5 * foreseen


def test_what_was_not_excited_is_foreseen_to_be_uncertain():
    clean = [loops(2.0), loops(3.0)]
    found = learn(clean, [error(command, seed) for seed, command in enumerate(clean)], STEP)
    assert found is not None
    slow, fast = (left(found, loops(frequency), error(loops(frequency), 7)) for frequency in (2.5, 20.0))
    assert fast[2] > 2.0 * slow[2]
    assert fast[1] < 3.0 * fast[2]


def test_an_error_that_does_not_follow_the_command_is_not_learned():
    random = np.random.default_rng(3)
    clean = [loops(2.0), loops(6.0)]
    assert learn(clean, [random.standard_normal(len(command)) for command in clean], STEP) is None
    assert learn(clean, [np.zeros(len(command)) for command in clean], STEP) is None


def test_the_form_in_a_model_file_has_all_of_it():
    clean = [loops(2.0)[:, None], loops(6.0)[:, None]]
    stated = discrepancy_of(clean, [error(command[:, 0], 1)[:, None] for command in clean], STEP)
    found = LearnedDiscrepancy.from_document(stated["learned"][0])
    again = LearnedDiscrepancy.from_document(found.document())
    np.testing.assert_allclose(again.factor, found.factor)
    command = loops(4.0)
    np.testing.assert_allclose(again.features.rows(command, STEP), found.features.rows(command, STEP))
    assert np.shape(stated["zero"]) == (1, 3) and stated["correlation"] > 0
    with pytest.raises(InputError, match="discrepancy.learned"):
        LearnedDiscrepancy.from_document({**found.document(), "mean": [1.0]})


def test_features_do_not_depend_on_the_sampling():
    coarse = loops(2.0)
    fine = np.interp(np.arange(4 * len(coarse)) * STEP / 4, np.arange(len(coarse)) * STEP, coarse)
    features = CommandFeatures.of([coarse], STEP)
    rows, dense = features.rows(coarse, STEP), features.rows(fine, STEP / 4)[::4]
    scale = np.std(rows, axis=0)
    assert np.quantile(np.abs(rows - dense) / scale, 0.95) < 0.1


def test_the_correlation_length_of_a_first_order_process():
    """Integrated autocorrelation time of an AR(1) process: (1 + a) / (1 - a)."""
    random, a = np.random.default_rng(0), 0.9
    rows = np.zeros(200000)
    noise = random.standard_normal(len(rows))
    for k in range(1, len(rows)):
        rows[k] = a * rows[k - 1] + noise[k]
    assert correlation_length(rows[:, None]) == pytest.approx((1 + a) / (1 - a), rel=0.1)
    assert correlation_length(noise[:, None]) < 1.2


@pytest.mark.parametrize("count", [2, 3, 6])
def test_the_next_session_is_usual_in_99_of_100_cases(count):
    random = np.random.default_rng(count)
    draws = random.standard_normal((4000, count + 1, 1, 3))
    usual = np.array([usual_zero(clean) for clean in draws[:, :count]])
    within = np.abs(draws[:, count]) <= usual
    assert within.mean() >= 0.988
    assert np.isnan(usual_zero(draws[0, :1])).all()
