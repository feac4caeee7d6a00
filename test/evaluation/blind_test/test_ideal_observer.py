# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Ceiling of an ideal observer, against its closed form for two effects and against drawn records for more."""

import numpy as np
import pytest
from scipy.stats import norm

from evaluation.blind_test.ideal_observer import ceiling


def products_of(fits: np.ndarray, record: np.ndarray) -> np.ndarray:
    """Products of what fits (E, M) leave of a record."""
    left = record - fits
    return left @ left.T


@pytest.mark.parametrize("distance", [0.5, 2.0, 6.0])
def test_two_effects_against_the_closed_form(distance):
    random = np.random.default_rng(0)
    fits = np.zeros((2, 50))
    fits[1, 7] = distance
    found = ceiling([["delay"], ["gain"]], products_of(fits, random.standard_normal(50)), [["delay"]])
    assert found == pytest.approx(norm.cdf(0.5 * distance), abs=0.04)


def test_several_effects_against_drawn_records():
    random = np.random.default_rng(1)
    fits = 0.35 * random.standard_normal((5, 40))
    names = [[name] for name in "abcde"]
    records = fits[2] + random.standard_normal((4000, 40))
    nearest = np.argmin(np.sum((records[:, None] - fits) ** 2, axis=2), axis=1)
    found = ceiling(names, products_of(fits, records[0]), [["c"]])
    assert 0.2 < found < 0.95
    assert found == pytest.approx(np.mean(nearest == 2), abs=0.04)


def test_an_effect_that_was_not_fitted_has_no_ceiling():
    assert ceiling([["delay"]], np.eye(1), [["gain"]]) is None
    assert ceiling([["delay"]], np.eye(1), [["delay"]]) == 1.0


def test_the_order_of_names_does_not_matter_and_a_larger_combination_is_no_rival():
    fits = np.array([[0.0, 0.0], [0.1, 0.0], [0.0, 0.1]])
    names = [["gain", "delay"], ["creep", "delay", "gain"], ["delay"]]
    found = ceiling(names, products_of(fits, np.zeros(2)), [["delay"], ["gain"]])
    assert found == pytest.approx(norm.cdf(0.05), abs=0.05)


def test_a_name_that_is_accepted_too_is_no_rival():
    fits = np.array([[0.0, 0.0], [1e-3, 0.0], [0.0, 3.0]])
    names = [["delay"], ["sensor_lowpass"], ["gain"]]
    products = products_of(fits, np.zeros(2))
    assert ceiling(names, products, [["delay"]]) < 0.6
    assert ceiling(names, products, [["delay", "sensor_lowpass"]]) == pytest.approx(norm.cdf(1.5), abs=0.04)


@pytest.mark.parametrize("distance", [1.0, 3.0, 6.0])
def test_nothing_is_as_probable_as_all_effects_together(distance):
    fits = np.zeros((5, 5))
    fits[0, 0] = distance
    fits[np.arange(2, 5), np.arange(2, 5)] = 50.0
    names = [["delay"], [], ["gain"], ["creep"], ["backlash"]]
    found = ceiling(names, products_of(fits, np.zeros(5)), [["delay"]])
    assert found == pytest.approx(norm.cdf(0.5 * distance - np.log(4) / distance), abs=0.04)
