# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Onsets and outliers in fleets drawn by numpy from known laws: what is named is right, and how often it is not is as stated."""

from __future__ import annotations

import numpy as np
import pytest

from hyst_control.fleet.change_points import find_changes
from hyst_control.fleet.course_fit import CourseFit
from hyst_control.fleet.outliers import find_outliers

UNITS, RUNS = 200, 50


def fleet(seed, affected=20, shift=3.0, walk=0.05, missing=0.1):
    """Levels that scatter by 1 between units; runs by 0.5; shifts of `shift` times the units' scatter from random runs on."""
    rng = np.random.default_rng(seed)
    values = rng.standard_normal((UNITS, 1)) + 0.5 * rng.standard_normal((UNITS, RUNS))
    values += np.cumsum(walk * rng.standard_normal((UNITS, RUNS)), axis=1)
    runs = {}
    for unit in rng.choice(UNITS, affected, replace=False):
        runs[f"u{unit}"] = int(rng.integers(3, RUNS - 3))
        values[unit, runs[f"u{unit}"] :] += shift * rng.choice([-1.0, 1.0])
    values[rng.random(values.shape) < missing] = np.nan
    return values, runs


def found_in(values):
    units = [f"u{index}" for index in range(len(values))]
    return find_changes("gain", units, np.arange(values.shape[1], dtype=float), values)[0]


def test_units_and_runs_are_found():
    hits = named = true = near = inside = 0
    for seed in range(3):
        values, runs = fleet(seed)
        onsets = found_in(values)
        named, true = named + len(onsets), true + len(runs)
        right = [onset for onset in onsets if onset.unit in runs]
        hits += len(right)
        near += sum(abs(onset.moment - runs[onset.unit]) <= 1 for onset in right)
        inside += sum(onset.earliest <= runs[onset.unit] <= onset.latest for onset in right)
        assert all(abs(abs(onset.size) - 3.0) < 5 * onset.size_error + 0.3 for onset in right)
    assert hits / named >= 0.95 and hits / true >= 0.90
    assert near / hits >= 0.90 and inside / hits >= 0.85


@pytest.mark.parametrize("walk", [0.0, 0.2])
def test_a_fleet_without_changes_names_hardly_any_unit(walk):
    named = [len(found_in(fleet(seed, affected=0, walk=walk)[0])) for seed in range(3)]
    assert sum(named) <= 1, "of 600 units"


def test_a_level_far_above_the_scatter_changes_nothing():
    """Values on a lattice of 2^-10, so that adding 2^40 is exact."""
    values = np.rint(1024.0 * np.random.default_rng(3).standard_normal(40)) / 1024.0
    shapes = np.triu(np.ones((40, 40)))[:, 3:-3]
    plain, far = (CourseFit(each, shapes, 1.0, 0.01) for each in (values, values + 2.0**40))
    assert far.likelihood == pytest.approx(plain.likelihood, rel=1e-9)
    np.testing.assert_allclose(far.evidence(3.0)[1], plain.evidence(3.0)[1], rtol=1e-9)
    assert far.level(5, 1.0) - 2.0**40 == pytest.approx(plain.level(5, 1.0), abs=1e-3)


def test_short_and_constant_series_are_left_out():
    assert found_in(np.zeros((5, 10))) == []
    assert found_in(np.full((5, 10), np.nan)) == []


def test_outliers_in_correlated_quantities():
    rng = np.random.default_rng(7)
    mixing = np.array([[1.0, 0.0, 0.0], [0.95, 0.3, 0.0], [0.2, 0.1, 1.0]])
    values = np.array([100.0, -3.0, 0.0]) + rng.standard_normal((200, 3)) @ mixing.T * np.array([10.0, 0.1, 1e-3])
    values[:20, 1] += 0.25  # well within each quantity's own scatter of 0.1, far off the correlation
    values[:20, 0] -= 20.0
    found = find_outliers([f"u{i}" for i in range(200)], ["a", "b", "c"], values)
    named = {outlier.unit for outlier in found}
    assert len(named & {f"u{i}" for i in range(20)}) >= 19
    assert len(named) <= 22
    clean = find_outliers([f"u{i}" for i in range(180)], ["a", "b", "c"], values[20:])
    assert len(clean) <= 1
    assert find_outliers(["a", "b"], ["q"], np.zeros((2, 1))) == []
