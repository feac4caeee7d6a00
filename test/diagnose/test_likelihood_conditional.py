# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Conditional Gaussian of a new record given baseline records, against conditioning of the joint covariance."""

import numpy as np
import pytest

from hyst_control.diagnose.likelihood.conditional import conditional

S, R = np.array([4.0, 0.3, 1e-3]), np.array([0.5, 0.8, 2.0])


@pytest.mark.parametrize("count", [0, 1, 3])
def test_against_conditioning_of_the_joint_covariance(count):
    random = np.random.default_rng(count)
    for k in range(len(S)):
        clean = random.standard_normal(count)
        joint = S[k] * np.ones((count + 1, count + 1)) + R[k] * np.eye(count + 1)  # the new record first
        new, between, among = joint[0, 0], joint[0, 1:], joint[1:, 1:]
        solved = np.linalg.solve(among, np.column_stack([clean, between])) if count else np.zeros((0, 2))
        mean, variance = between @ solved[:, 0], new - between @ solved[:, 1]
        average = np.array([clean.mean() if count else 0.0])
        found = conditional(average, S[k : k + 1], R[k : k + 1], count)
        assert (found[0][0], found[1][0]) == (pytest.approx(mean, abs=1e-12), pytest.approx(variance, abs=1e-12))


@pytest.mark.parametrize(
    ("repeating", "varying", "count", "kept", "variance"),
    [
        (1e9, 2.0, 4, 1.0, 2.5),  # what repeats dominates: the mean is subtracted, variance R (1 + 1/n)
        (3.0, 2.0, 0, 0.0, 5.0),  # no baseline record: R + S
        (1e-12, 2.0, 4, 0.0, 2.0),  # the model is right: noise alone
        (3.0, 2.0, 10**9, 1.0, 2.0),  # very many records: the discrepancy is known
        (3.0, 1e-12, 1, 1.0, 0.0),  # no noise: one record says all
    ],
)
def test_its_limits(repeating, varying, count, kept, variance):
    mean, found = conditional(np.array([1.0]), np.array([repeating]), np.array([varying]), count)
    assert mean[0] == pytest.approx(kept, abs=1e-6)
    assert found[0] == pytest.approx(variance, abs=1e-6)
