# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Values that stand still, each beside what it must not take for its finding."""

from __future__ import annotations

import numpy as np
import pytest

from hyst_control.diagnose.record_checks.repeated_values import level_crossings, repeated_samples, stuck_stretches
from hyst_control.diagnose.record_checks.summary import (
    lattice_of,
)

STEP = 5e-3
TIME = STEP * np.arange(6000)


def test_numbers_of_few_digits_are_no_held_samples():
    """A slow motion in noise, printed with so few digits that neighbors coincide now and then, on more levels than a lattice has."""
    random = np.random.default_rng(1)
    printed = np.round(20.0 * np.sin(2 * np.pi * TIME) + 0.2 * random.standard_normal(len(TIME)), 3)
    same = np.mean(np.diff(printed) == 0.0)
    assert same > 5e-4
    assert repeated_samples(printed, 0.0, 0.2)[0] == 0.0
    held = printed.copy()
    for k in np.flatnonzero(random.random(len(held)) < 0.02):
        held[k] = held[max(k - 1, 0)]
    assert repeated_samples(held, 0.0, 0.2)[0] == pytest.approx(0.02, abs=0.006)


@pytest.mark.parametrize("fraction", [0.5, 0.75, 0.95])
def test_most_samples_may_be_held(fraction):
    """Of nineteen samples in twenty that are held, whole stretches stand still: that is no coarse printing."""
    random = np.random.default_rng(4)
    held = 20.0 * np.sin(2 * np.pi * TIME) + 0.02 * random.standard_normal(len(TIME))
    for k in np.flatnonzero(random.random(len(held)) < fraction):
        held[k] = held[max(k - 1, 0)]
    assert repeated_samples(held, 0.0, 0.02)[0] == pytest.approx(fraction, abs=0.03)


def test_rest_before_a_step_is_no_held_samples_on_a_lattice():
    time = np.arange(20000) * 1e-4
    steps = np.cumsum(np.where(np.arange(20000) % 100 == 50, 1.0, 0.0) * np.random.default_rng(3).normal(size=20000))
    moved = np.convolve(steps, np.exp(-np.arange(200) / 5.0) / 5.0)[:20000] + 0.5 * np.sin(2 * np.pi * 40.0 * time)
    step = 0.004
    rounded = step * np.rint(moved / step)
    share, count = repeated_samples(rounded, lattice_of(rounded), 1e-3)
    assert count >= 200 and share < 0.005
    random = np.random.default_rng(4)
    for k in np.flatnonzero(random.random(20000) < 0.05):
        rounded[k] = rounded[max(k - 1, 0)]
    assert repeated_samples(rounded, lattice_of(rounded), 1e-3)[0] == pytest.approx(0.05, abs=0.02)


def test_a_dead_band_comes_back_to_one_value_and_held_samples_do_not():
    random = np.random.default_rng(7)
    command = np.sin(2 * np.pi * 8.0 * np.linspace(0.0, 1.0, 4000))
    measured = 10.0 * command + 0.05 * random.normal(size=4000)

    def stuck(values, drive=command, step=0.0):
        return stuck_stretches([(drive, values)], step, 0.05)

    assert stuck(measured) == 0
    dead = np.sign(measured) * np.maximum(np.abs(measured) - 0.5, 0.0)
    assert stuck(dead) >= 16  # it is crossed twice a period
    assert stuck(np.minimum(measured, 9.0)) >= 8  # so is the end of a sensor's range
    held = measured.copy()
    for k in np.flatnonzero(random.random(4000) < 0.2)[1:]:
        held[k] = held[k - 1]
    assert stuck(held) == 0
    assert stuck(np.round(measured, 1), step=0.1) == 0
    assert stuck(dead, drive=np.zeros(4000)) == 0  # at rest it may stand where it likes
    assert stuck_stretches([(command, np.minimum(command, 0.9))], 0.0, 0.0) == 0


def test_a_dead_band_under_the_noise_is_told_by_the_level_that_it_is_passed_on():
    """Noise behind the band: no value comes back. What stands elsewhere, or turns there, is none."""
    random, time = np.random.default_rng(8), np.arange(8000) / 8000
    motion = 10.0 * np.sin(2 * np.pi * 8.0 * time) * (1.0 - 0.5 * time)
    fast = motion + 1.5 * np.sin(2 * np.pi * 300.0 * time)

    def passed(values, simulated=motion, noise=0.02, step=0.0):
        return level_crossings([(simulated, values + noise * random.normal(size=len(values)))], step, 0.02)

    def play(values, half=1.0):
        place = np.zeros_like(values)
        for k in range(1, len(values)):
            place[k] = np.clip(place[k - 1], values[k] - half, values[k] + half)
        return place

    def dead(values, half=1.0):
        return values - np.clip(values, -half, half)

    assert passed(dead(motion)) >= 14  # twice in each of eight periods
    assert passed(dead(motion + 1.0, 1.2), 1.1 * motion + 1.0) >= 14
    assert passed(dead(motion), noise=0.0) >= 14
    assert passed(motion) == 0 and passed(0.8 * motion) == 0
    assert passed(np.minimum(motion, 4.0)) < 2  # turns where it came from
    assert passed(play(10.0 * np.sin(2 * np.pi * 8.0 * time))) < 2
    assert passed(motion, fast) < 2 and passed(np.roll(motion, 40), motion) < 2  # a low-pass, a delay
    assert passed(np.round(dead(motion), 1), step=0.1) == 0
    assert passed(np.round(dead(motion), 2), step=0.01) >= 14  # a lattice that the noise hides
    assert level_crossings([(motion, dead(motion))], 0.0, 0.0) == 0
    few = motion[::25]  # most samples are held, and the motion passes by meanwhile
    for seed in range(20):
        seen, kept = few + 0.02 * random.normal(size=len(few)), np.random.default_rng(seed).random(len(few)) > 0.9
        assert passed(seen[np.maximum.accumulate(np.where(kept, np.arange(len(few)), 0))], few, noise=0.0) < 2


def test_a_hum_that_now_and_then_cancels_the_motion_is_no_dead_band():
    """A triangle of 10 Hz and a hum of 50 Hz keep step: at one level the sum stands once a period, on few of all passages."""
    time = np.arange(8000) / 2000
    triangle = 20.0 * np.abs(2.0 * ((10.0 * time) % 1.0) - 1.0)
    hum = 1.27 * np.sin(2 * np.pi * 50.0 * time)
    noise = 0.02 * np.random.default_rng(4).normal(size=len(time))
    assert level_crossings([(triangle, triangle + hum + noise)], 0.0, 0.02) < 2


def test_a_step_out_of_rest_is_no_dead_band():
    """The simulation jumps one sample before the measurement, which stood before because nothing but a hum moved."""
    level = np.repeat([0.0, 9.0, 0.0, 12.0, 0.0, 7.0, 0.0, 11.0], 200)
    noise = 0.02 * np.random.default_rng(5).normal(size=len(level))
    hum = 0.3 * np.sin(2 * np.pi * 50.0 * np.arange(len(level)) / 2000)
    assert level_crossings([(np.roll(level, -1), level + hum + noise)], 0.0, 0.02) < 2
