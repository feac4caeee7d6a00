# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Functions of whole signals against those of scipy.signal, which is too slow to import for a command."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from scipy import signal

from hyst_control.base.signals import averaged_periodogram, convolved, correlated, lagging, low_passed, periodogram

ROWS = np.random.default_rng(0).standard_normal((999, 2)).cumsum(axis=0)


def test_products_at_all_shifts():
    one, other = ROWS[:, 0], ROWS[:77, 1]
    np.testing.assert_allclose(convolved(one, other), signal.convolve(one, other), atol=1e-8)
    np.testing.assert_allclose(correlated(one, other), signal.correlate(one, other), atol=1e-8)


@pytest.mark.parametrize("count", [998, 999])
@pytest.mark.parametrize("linear", [False, True])
def test_spectrum(count, linear):
    rows = ROWS[:count]
    frequency, power = periodogram(rows, 50.0, linear)
    expected = signal.periodogram(rows, 50.0, "hann", detrend="linear" if linear else "constant", axis=0)
    np.testing.assert_allclose(frequency, expected[0])
    np.testing.assert_allclose(power, expected[1], atol=1e-9 * expected[1].max())
    np.testing.assert_allclose(periodogram(rows[:, 0], 50.0, linear)[1], power[:, 0])


@pytest.mark.parametrize("length", [2, 100, 101, 999])
@pytest.mark.parametrize("centered", [False, True])
def test_averaged_spectrum(length, centered):
    frequency, power = averaged_periodogram(ROWS[:, 0], 50.0, length, centered)
    expected = signal.welch(ROWS[:, 0], 50.0, "hann", length, detrend="constant" if centered else False)
    np.testing.assert_allclose(frequency, expected[0])
    np.testing.assert_allclose(power, expected[1], atol=1e-9 * expected[1].max())


@pytest.mark.parametrize("corner", [0.05, 0.4])
def test_low_pass_without_a_lag(corner):
    """Away from the ends, which each takes as it likes."""
    expected = signal.sosfiltfilt(signal.butter(2, corner, output="sos"), ROWS, axis=0)
    np.testing.assert_allclose(low_passed(ROWS, corner)[150:-150], expected[150:-150], atol=0.01 * np.ptp(ROWS))
    assert low_passed(ROWS[:, 0], corner) == pytest.approx(low_passed(ROWS, corner)[:, 0])


def test_lag():
    """With a signal at rest before it begins."""
    expected, _ = signal.lfilter([0.3, -0.1], [1.0, -0.8], ROWS[:, 0], zi=[0.7 * ROWS[0, 0]])
    np.testing.assert_allclose(lagging(ROWS[:, 0].copy(), 0.8, -0.1, 0.3), expected)


def test_a_diagnosis_loads_nothing_slow():
    code = "import sys, hyst_control.diagnose.workflow; print([name for name in ('scipy.signal', 'scipy.stats') if name in sys.modules])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
