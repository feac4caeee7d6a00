# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Periods of a single baseline record of the same command: what they differ by stands for what sessions differ by."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.fft import dct

from hyst_control.diagnose.configuration import CONFIGURATION
from hyst_control.diagnose.model_error.baseline import Baseline
from hyst_control.diagnose.run.diagnosis import with_clean
from test.diagnose.test_baseline import MODEL, RATE, record

PERIOD, PERIODS, NOISE, SLIP = 250, 8, 0.002, 4e-5
TIME = np.arange(PERIOD * PERIODS) / RATE
FREQUENCY = RATE / PERIOD
COMMAND = 40.0 - 40.0 * np.cos(2 * np.pi * FREQUENCY * TIME)
WARM_UP = 2 * PERIOD / RATE


def measured(seed: int, late: np.ndarray | float = 0.0) -> np.ndarray:
    """A machine with a delay of its own, whose clock differs from that of the command by `late` seconds."""
    angle = 2 * np.pi * FREQUENCY * (TIME - 1e-3 - late)
    return 1.0 - np.cos(angle) + 0.1 * np.cos(2 * angle) + NOISE * np.random.default_rng(seed).standard_normal(len(TIME))


def beside(clean: np.ndarray, new: np.ndarray, warm_up: float) -> Baseline:
    records = [record(COMMAND, one, source) for one, source in ((new, "new"), (clean, "clean"))]
    baseline = with_clean(records[:1], MODEL, warm_up, CONFIGURATION, records[1:])[3][0][1]
    assert baseline is not None and baseline.carried
    return baseline


def first_counted(warm_up: float) -> int:
    keep = beside(measured(0), measured(1), warm_up).problem.pieces[0].keep
    return 0 if keep is None else int(np.argmax(keep))


def test_rows_of_a_warm_up_wipe_the_memory_out() -> None:
    """The command met both its extremes in the warm-up: the rows behind it say nothing of the time before the record."""
    assert first_counted(WARM_UP) == round(WARM_UP * RATE)
    assert first_counted(0.0) == pytest.approx(PERIOD / 2, abs=0.1 * PERIOD)  # where the command is at its largest


@pytest.mark.parametrize("period", [3, 5])
def test_a_clock_that_slips_in_any_period_behind_the_warm_up_is_known_of(period: int) -> None:
    """Periods differ by that; the next session may be late by it all along, which is then no effect."""
    slipped = np.where(TIME * FREQUENCY < period, SLIP, 0.0)
    spectrum = beside(measured(0, slipped), measured(1), WARM_UP).problem.own_spectrum
    assert spectrum is not None
    counted = round(WARM_UP * RATE)
    late = dct((measured(1, SLIP) - measured(1))[counted:], norm="ortho")
    # One period of six is off: 5/36 of the energy of a session that is off altogether, of two records, over about six bins.
    line = 2 * (PERIODS - 2)
    assert spectrum.power[line, 0] > 0.5 * 2.0 * 5.0 / 36.0 * float(np.sum(late**2)) / 6.0


def test_the_memory_that_fills_in_the_first_period_is_nothing_that_periods_differ_by() -> None:
    """The memory of the time before a record fades in its first period; behind it the machine repeats up to its noise."""
    fading = 0.3 * np.sin(2 * np.pi * FREQUENCY * TIME) * np.where(TIME * FREQUENCY < 1.2, 1.0, 0.0)
    repeatability = beside(measured(0, 0.0) + fading, measured(1), 0.0).repeatability
    assert repeatability == pytest.approx(np.sqrt(2.0) * NOISE, rel=0.2)


def test_a_single_period_that_counts_is_held_against_the_one_of_the_warm_up() -> None:
    """As on a mirror whose records are two periods, the first a warm-up: what these differ by is no gap of the next session."""
    counted = TIME * FREQUENCY >= PERIODS - 1
    slip = 20.0 * SLIP
    found = beside(measured(0, np.where(counted, 0.0, slip)), measured(1), (PERIODS - 1) * PERIOD / RATE).repeatability
    place, difference = np.linspace(-1.0, 1.0, PERIOD), (measured(1, slip) - measured(1))[counted]
    beside_zero = difference - np.polyval(
        np.polyfit(place, difference, 2), place
    )  # zero, drift and curvature are each session's own
    assert found == pytest.approx(np.hypot(np.std(beside_zero), np.sqrt(2.0) * NOISE), rel=0.15)
