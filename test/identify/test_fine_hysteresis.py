# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A hysteresis of many play operators, written in numpy, in front of a mode: fitted to its noise, from wherever the record begins."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

from hyst_control.identify import identify
from hyst_control.identify.data.initial_memory import ESTIMATED, FILLED, PERIODIC, with_beginning
from hyst_control.model_file import simulate
from hyst_control.records.record import sampled_record

STEP, NOISE, RANGE = 1e-4, 2e-3, 100.0  # s, um, V
THRESHOLDS = np.linspace(3.0, 42.0, 17)  # V
WEIGHTS = 0.03 * np.exp(-np.arange(17) / 6.0) / np.exp(-np.arange(17) / 6.0).sum()  # um/V
TIME = STEP * np.arange(10_000)


def measured(
    command: np.ndarray, before: tuple[float, ...] = (), seed: int = 0, mode: float = 600.0, curve: float = 0.0
) -> np.ndarray:
    """Displacement in um of play operators before a mode (Hz), which rests at the first command, brought there from 0 V.

    before: turning points (V) on the way; curve: um/V^2, of a parabola beside the operators.
    """
    state = np.zeros(len(THRESHOLDS))
    for turn in (*before, command[0]):
        state = np.clip(state, turn - THRESHOLDS, turn + THRESHOLDS)
    input_ = np.empty(len(command))
    for row, volts in enumerate(command):
        state = np.clip(state, volts - THRESHOLDS, volts + THRESHOLDS)
        input_[row] = 0.07 * volts + curve * volts**2 + WEIGHTS @ state
    omega = 2.0 * np.pi * mode
    top, bottom, _ = cont2discrete(([omega**2], [1.0, 0.1 * omega, omega**2]), STEP, "zoh")
    about = input_ - input_[0]
    moved = lfilter(np.ravel(top)[1:], bottom, np.concatenate([[0.0], about[:-1]]))
    return input_[0] + moved + NOISE * np.random.default_rng(seed).normal(size=len(command))


def multisine(seed: int) -> np.ndarray:
    """One period of sines up to 900 Hz, about half of the range."""
    lines = np.unique(np.round(np.geomspace(1, 900, 50)).astype(int))
    phases = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, len(lines))
    sines = np.sum(lines**-0.5 * np.cos(2.0 * np.pi * np.outer(TIME, lines) + phases), axis=1)
    return 0.5 * RANGE + 0.4 * RANGE * sines / np.abs(sines).max()


def triangle() -> np.ndarray:
    """Loops from 8 V up that become smaller."""
    return 0.5 * RANGE + 0.42 * RANGE * np.interp(TIME, [0.0, 1.0], [1.0, 0.3]) * (
        4.0 * np.abs((6.0 * TIME + 0.5) % 1.0 - 0.5) - 1.0
    )


def record(command: np.ndarray, measurement: np.ndarray, start: str = "auto"):
    return sampled_record("fine", command[:, None], measurement[:, None], STEP, ("x",), "um", "zoh", start)


@pytest.fixture(scope="module")
def records():
    commands = multisine(1), triangle()
    return [record(command, measured(command, seed=seed)) for seed, command in enumerate(commands)]


def test_as_many_operators_as_the_records_show_leave_noise(records):
    fit, coarse = identify(records, "hapi"), identify(records, "hapi", operators=10)
    left, left_by_few = (max(row["rmse"] for row in each.report["records"]) for each in (fit, coarse))
    assert left < 1.5 * NOISE and left_by_few > 2.0 * NOISE
    fresh = multisine(5)
    assert np.std(simulate(fit.model, fresh[:, None], STEP, "zoh")[:, 0] - measured(fresh, seed=5)) < 1.6 * NOISE


def test_few_operators_are_kept_where_noise_hides_more(records):
    random = np.random.default_rng(9)
    noisy = [each.with_values(measurement=each.measurement + random.normal(0.0, 0.2, each.measurement.shape)) for each in records]
    weights = [row for row in identify(noisy, "hapi").report["parameters"] if row["name"].startswith("weights")]
    assert len(weights) <= 10


def test_a_record_that_surely_begins_on_its_loading_curve_counts_from_its_first_row(records):
    first = with_beginning(records[1]).start
    assert first.assumed == ESTIMATED and first.row == 0
    noise = np.random.default_rng(3).normal(0.0, 0.2, len(TIME))
    for other in (measured(triangle(), before=(95.0,)), measured(triangle()) + noise):
        begins = with_beginning(record(triangle(), other)).start
        assert begins.assumed == FILLED and begins.row > 0


def test_a_period_that_begins_at_rest_is_not_preceded_by_itself():
    """Also where a resonance moves the stage more than its hysteresis."""
    command, mode = multisine(1), 400.0
    assert with_beginning(record(command, measured(command, mode=mode))).start.assumed == ESTIMATED
    steady = record(command, measured(np.tile(command, 2), mode=mode)[len(command) :])
    assert with_beginning(steady).start.assumed == PERIODIC


def test_an_asymmetric_hysteresis_is_fitted_and_predicts_another_command_to_the_noise():
    """Its slope rises by half over the range; one k for all weights leaves a multiple of the noise."""
    commands, fresh, curve = (multisine(1), triangle()), multisine(7), 2.5e-4
    records = [record(each, measured(each, seed=seed, curve=curve)) for seed, each in enumerate(commands)]
    left = measured(fresh, seed=9, curve=curve)
    errors = {
        levels: np.std(simulate(identify(records, "hampi", levels=levels).model, fresh[:, None], STEP, "zoh")[:, 0] - left) / NOISE
        for levels in (False, True)
    }
    assert errors[True] < 1.6 and errors[False] > 4.0
