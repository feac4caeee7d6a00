# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers of independent samples in correlated series, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from hyst_control.records.correlation import matching_length


@pytest.mark.parametrize(("periods", "within"), [(3, 0.1), (40, 0.01)])
def test_a_sine_has_two_independent_samples(periods, within):
    """Of few periods the ends count."""
    rows = np.sin(2 * np.pi * periods * np.arange(6000) / 6000)[:, None]
    assert matching_length(rows) == pytest.approx(3000, rel=within)


@pytest.mark.parametrize("pole", [0.0, 0.9, 0.99])
def test_a_first_order_process_forgets_by_its_pole(pole):
    """By chance an autocorrelation's sum is up to about twice as large as the process' own."""
    rows = lfilter([1.0], [1.0, -pole], np.random.default_rng(1).standard_normal(20_000))[:, None]
    due = (1.0 + pole**2) / (1.0 - pole**2)
    assert due <= matching_length(rows) <= 3.0 * due
