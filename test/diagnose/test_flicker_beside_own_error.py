"""1/f noise beside clean records whose sessions differ by something that falls with frequency as well."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hyst_control.diagnose.configuration import CONFIGURATION
from hyst_control.diagnose.error_spectrum import ErrorSpectrum
from hyst_control.diagnose.evidence_collection import _flicker
from hyst_control.diagnose.hypothesis_fit import Solution
from hyst_control.diagnose.hypothesis_search import Scored
from test.diagnose.test_baseline import RATE
from test.diagnose.test_periods_of_a_clean_record import NOISE, PERIOD, WARM_UP, beside, measured

NONE = np.zeros(0)


@pytest.mark.parametrize("seed", range(3))
def test_what_sessions_differ_by_is_no_flicker_noise(seed: int) -> None:
    """What is left has the spectrum of their difference and chances to be a little larger; twice as much and more is new."""
    problem = beside(measured(0), measured(1), WARM_UP).problem
    rows, random = 6 * PERIOD, np.random.default_rng(seed)
    frequencies = 0.5 * RATE * np.arange(rows) / rows
    falling = 100.0 * NOISE**2 / np.maximum(np.arange(rows), 1.0)[:, None]
    problem = replace(problem, sigma=np.array([NOISE]), own_spectrum=ErrorSpectrum(frequencies, falling, np.array([NOISE])))
    white = random.standard_normal(rows)
    usual = 1.02 * white / np.sqrt(np.mean(white**2))
    shape = np.fft.rfft(random.standard_normal(rows)) / np.sqrt(np.maximum(np.arange(rows // 2 + 1), 1.0))
    flicker = np.fft.irfft(shape, rows)
    new = usual + problem.whitened(4.0 * flicker / flicker.std())
    gains = []
    for residual in (usual, new):
        seen = _flicker(problem, Scored(None, Solution(0.0, NONE, NONE, residual, NONE, NONE), 0.0), CONFIGURATION)
        assert seen is not None
        gains.append(seen.gain)
    assert gains[0] < 5.0 and gains[1] > 30.0
