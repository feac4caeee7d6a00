# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Ranges of the catalogue's effects: as large as physics allows, on a record of any size."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hyst_control.effects import EFFECTS
from hyst_control.effects.effect import Surroundings

STEP = 1e-4
AROUND = Surroundings(STEP, 1.0, (-20.0, 30.0), 1e4, (-1.0, 2.0), 1)
STROKE = 3.0


def reach(name: str, parameter: str, lowest_frequency: float) -> tuple[float, float]:
    around = replace(AROUND, lowest_frequency=lowest_frequency)
    found = next(one for one in EFFECTS[name].parameters(around) if one.name == parameter)
    return found.lower, found.upper


@pytest.mark.parametrize("lowest_frequency", [1.0, 5.0])
@pytest.mark.parametrize(
    "name, parameter, least",
    [
        ("vibration", "amplitude", 0.5 * STROKE),
        ("mains_hum", "amplitude", 0.5 * STROKE),
        ("backlash", "half_width", 0.5 * STROKE),
        ("creep", "gamma", 0.5),
        ("offset_drift", "change", 0.5 * STROKE),
    ],
)
def test_an_effect_may_be_half_of_the_range(name, parameter, least, lowest_frequency):
    assert reach(name, parameter, lowest_frequency)[1] >= least


def test_a_gain_may_be_a_third_of_the_model_s():
    assert reach("gain", "gain", 1.0)[0] < -0.65 and reach("gain_drift", "change", 1.0)[0] < -0.65


@pytest.mark.parametrize("name", ["amplifier_lowpass", "sensor_lowpass"])
@pytest.mark.parametrize("lowest_frequency", [1.0, 5.0])
def test_a_filter_ends_at_the_nyquist_frequency(name, lowest_frequency):
    """Above it a low-pass is a delay: no sample shows that it takes anything off."""
    lower, upper = reach(name, "cutoff", lowest_frequency)
    assert upper == pytest.approx(0.5 / STEP)
    assert lower <= 0.1 * lowest_frequency


def test_wide_and_narrow_play_are_both_begun_at():
    starts = next(one for one in EFFECTS["backlash"].parameters(AROUND) if one.name == "half_width").starts
    assert min(starts) < 0.01 * STROKE and max(starts) > 0.1 * STROKE


def test_slew_limits_are_looked_for_far_below_a_step():
    """The largest slope of a command with a step is that of one sample: a driver limits to a hundredth of it."""
    starts = next(one for one in EFFECTS["slew_limit"].parameters(AROUND) if one.name == "rate").starts
    assert min(starts) < 0.005 * AROUND.slew and max(starts) > 0.5 * AROUND.slew


@pytest.mark.parametrize("share", [0.07, 0.2, 0.37, 0.45, 0.55, 0.65, 0.74, 0.82])
def test_some_start_of_a_slew_limit_explains_most_of_what_it_does(share):
    """With too few starts each of them leaves nearly as much as no limit at all, and no fit begins well. The limit here is numpy's."""
    time = np.arange(4000) * STEP
    command = 10.0 * np.sin(2 * np.pi * 20.0 * time) + 3.0 * np.sin(2 * np.pi * 85.0 * time + 1.0)
    slew = float(np.abs(np.diff(command)).max()) / STEP
    starts = next(one for one in EFFECTS["slew_limit"].parameters(replace(AROUND, slew=slew)) if one.name == "rate").starts

    def limited(rate: float) -> np.ndarray:
        state, found = command[0], np.empty_like(command)
        for row, value in enumerate(command):
            state += np.clip(value - state, -rate * STEP, rate * STEP)
            found[row] = state
        return found

    true = limited(share * slew)
    left = min(float(np.sum((limited(start) - true) ** 2)) for start in starts)
    assert left < 0.25 * float(np.sum((command - true) ** 2))


@pytest.mark.parametrize("rate", [200.0, 1e3, 2e4])
def test_slow_modes_are_searched_for_only_where_the_model_discrepancy_is_unknown(rate):
    around = replace(AROUND, sample_time=1.0 / rate, duration=20.0)
    slow, fast = (EFFECTS["resonance"].parameters(replace(around, beside_error=known))[0] for known in (False, True))
    assert min(slow.starts) == pytest.approx(10.0 / 20.0) and min(fast.starts) == pytest.approx(min(200.0, 0.1 * rate))
    assert all(one.lower <= start <= one.upper for one in (slow, fast) for start in one.starts)
