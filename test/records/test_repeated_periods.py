# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The period of a command, against commands whose period is known."""

import numpy as np
import pytest

from hyst_control.records.repeated_periods import period_of

TIME = np.arange(12000.0)


def multisine(period, seed):
    rng = np.random.default_rng(seed)
    lines = np.arange(1, 60)
    return np.cos(2 * np.pi * TIME[:, None] * lines / period + rng.uniform(0, 2 * np.pi, 59)).sum(axis=1)[:, None]


@pytest.mark.parametrize("period", [150, 1024, 3999, 6000])
def test_it_is_found_to_the_sample(period):
    assert period_of(multisine(period, period)) == period
    assert period_of(5.0 + np.sin(2 * np.pi * TIME / period)[:, None]) == period


def test_of_several_axes_the_period_of_all_counts():
    assert period_of(np.hstack([multisine(1000, 1), multisine(1500, 2)])) == 3000


def test_what_does_not_repeat_has_none():
    rng = np.random.default_rng(3)
    assert period_of(rng.standard_normal((4000, 1))) is None
    assert period_of(np.sin(2 * np.pi * TIME * (1 + TIME / 2e5) / 900)[:, None]) is None
    assert period_of(multisine(7000, 4)) is None  # less than two of them
    assert period_of(TIME[:, None]) is None
    fading = np.sin(2 * np.pi * TIME / 500) * np.linspace(1.0, 0.7, len(TIME))
    assert period_of(fading[:, None]) is None
