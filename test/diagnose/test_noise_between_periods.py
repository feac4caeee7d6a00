# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Noise of a periodic record: what its periods differ by, whatever the model leaves."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from hyst_control.chain import Chain
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.diagnose.noise.white import noise_between_periods
from hyst_control.diagnose.run.diagnosis import problem_of
from hyst_control.model_file import Model
from hyst_control.records.record import Record, Signal

PERIOD, NOISE = 2000, 0.01
MODEL = Model("gain", ("x",), {"command": "V", "measurement": "um"}, 1e-4, Chain((TransferFunction([1.0], [1.0]),)))


def periodic(periods: int) -> np.ndarray:
    """White up to the end of the spectrum: what a wrong model leaves is as rough as noise."""
    return np.tile(np.random.default_rng(1).normal(size=PERIOD), periods)


def record(command: np.ndarray, measurement: np.ndarray) -> Record:
    time = 1e-4 * np.arange(len(command))
    return Record(
        {"command": Signal(time, command[:, None], ("x",), "V"), "measurement": Signal(time, measurement[:, None], ("x",), "um")},
        "it",
    )


@pytest.mark.parametrize(("periods", "warm_up"), [(2, 0.2), (3, 0.0), (6, 0.0)])
def test_a_wrong_model_does_not_raise_it(periods, warm_up):
    command = periodic(periods)
    noise = NOISE * np.random.default_rng(2).normal(size=len(command))
    problem, _ = problem_of([record(command, 1.3 * command + noise)], MODEL, warm_up)
    assert problem.sigma[0] == pytest.approx(NOISE, rel=0.1)
    once = np.random.default_rng(3).normal(size=len(command))
    without, _ = problem_of([record(once, 1.3 * once + noise)], MODEL, warm_up)
    assert without.sigma[0] > 10 * NOISE


def test_noise_of_any_color_counts_with_all_its_power():
    command = periodic(4)
    white = np.random.default_rng(4).normal(size=(20, len(command)))
    colored = lfilter([0.3], [1.0, -0.7], white, axis=1)
    found = [noise_between_periods([command + NOISE * one], [command[:, None]]) for one in colored]
    assert np.mean(found) == pytest.approx(NOISE * np.sqrt(0.09 / 0.51), rel=0.05)


def test_zero_and_drift_are_no_noise():
    command = periodic(4)
    time = np.linspace(-1.0, 1.0, len(command))
    noise = NOISE * np.random.default_rng(5).normal(size=len(command))
    drifting = command + noise + 3.0 + 0.5 * time + 0.2 * time**2
    assert noise_between_periods([drifting], [command[:, None]]) == pytest.approx(NOISE, rel=0.1)


def test_copies_and_commands_that_do_not_repeat_say_nothing():
    command = periodic(2)
    assert noise_between_periods([command], [command[:, None]]) == np.inf
    once = np.random.default_rng(6).normal(size=4000)
    assert noise_between_periods([once], [once[:, None]]) == np.inf


def test_beside_a_carried_record_the_noise_of_both_counts():
    from hyst_control.diagnose.configuration import CONFIGURATION
    from hyst_control.diagnose.run.diagnosis import _beside
    from hyst_control.diagnose.run.prepare import nominal_residuals, with_noise

    command = periodic(4)
    random = np.random.default_rng(7)
    new, clean = (
        problem_of([record(command, 1.3 * command + NOISE * random.normal(size=len(command)))], MODEL)[0] for _ in range(2)
    )
    beside = _beside(new, clean, CONFIGURATION)
    assert beside is not None and beside.carried
    found = with_noise(beside.problem, nominal_residuals(beside.problem), CONFIGURATION)
    assert found.sigma[0] == pytest.approx(np.sqrt(2.0) * NOISE, rel=0.1)
