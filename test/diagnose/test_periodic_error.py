# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A discrepancy comes back with every period of the command: what the periods differ by is noise, or comes with time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hyst_control.chain import Chain
from hyst_control.chain.memoryless import Gain
from hyst_control.diagnose.configuration import CONFIGURATION
from hyst_control.diagnose.model_error.between_periods import by_periods, gain_over_time
from hyst_control.diagnose.problem.periodic_error import PeriodicError
from hyst_control.diagnose.run.diagnosis import with_clean
from hyst_control.diagnose.run.prepare import prepare
from hyst_control.diagnose.search.fit import fit
from hyst_control.diagnose.workflow import diagnosed
from hyst_control.model_file import Model
from hyst_control.records.record import Record, Signal
from hyst_control.records.repeated_periods import period_of
from test.diagnose.conftest import all_but

STEP, PERIOD, PERIODS, NOISE = 1e-3, 250, 8, 0.01
TIME = STEP * np.arange(PERIOD * PERIODS)
COMMAND = 10.0 * np.sin(2 * np.pi * TIME / (PERIOD * STEP))
ERROR = 0.3 * (COMMAND / 10.0) ** 3 - 0.2 * np.cos(6 * np.pi * TIME / (PERIOD * STEP))
"""Model discrepancy on the healthy machine, 20 times the noise."""


STATED = {"rms": [float(np.std(ERROR))], "correlation": 0.2}
MODEL = Model("m", ("x",), {"command": "V", "measurement": "um"}, STEP, Chain((Gain(1.0),)), "foh", discrepancy=STATED)


def record(added: np.ndarray, seed: int, command: np.ndarray = COMMAND, error: np.ndarray = ERROR) -> Record:
    measured = command + error + added + NOISE * np.random.default_rng(seed).standard_normal(len(TIME))
    return Record(
        {
            "command": Signal(TIME, command[:, None], ("x",), "V"),
            "measurement": Signal(TIME, measured[:, None], ("x",), "um"),
        },
        "new",
    )


def verdict(added: np.ndarray, seed: int) -> tuple[str, list[dict]]:
    document, _, _ = diagnosed([record(added, seed)], MODEL, without=all_but("gain", "gain_drift", "delay"), cache=False)
    return document["verdict"], document["effects"]


def nats_of_a_drift(new: Record) -> float:
    _, _, _, [(part, known, _)] = with_clean([new], MODEL, 0.0, CONFIGURATION, ())
    prepared = prepare(part, known, (), CONFIGURATION)
    beside = by_periods(known, prepared.problem)
    assert beside is not None
    return gain_over_time(beside, prepared.linearized, fit(prepared.linearized))


@pytest.mark.parametrize("change", [0.01, -0.02])
def test_a_gain_that_drifts_is_named_below_the_discrepancy(change):
    found, effects = verdict(change * TIME / TIME[-1] * (COMMAND + ERROR), 1)
    assert (found, [one["name"] for one in effects]) == ("effect", ["gain_drift"])
    assert effects[0]["parameters"]["change"]["value"] == pytest.approx(change, rel=0.2)


@pytest.mark.parametrize("seed", range(4))
def test_the_discrepancy_itself_is_no_gap(seed):
    assert verdict(np.zeros(len(TIME)), seed) == ("no_gap", [])


def test_a_gain_below_the_discrepancy_stays_one_with_it():
    assert verdict(0.02 * COMMAND, 5)[0] == "no_gap"


def test_the_closed_form_says_when_to_look_again():
    """Without a drift it is about half a chi-square of three degrees, whatever settles; with one, what least squares remove."""
    settling = 0.3 * np.exp(-TIME / 0.6)
    clean = [nats_of_a_drift(record((seed % 2) * settling, seed)) for seed in range(10)]
    assert 0.5 < np.mean(clean) < 4.0 and np.max(clean) < 15.0
    found = nats_of_a_drift(record(0.002 * TIME / TIME[-1] * COMMAND, 1))
    later = TIME >= PERIOD * STEP
    drift = COMMAND[later] * (TIME[later] - TIME[later].mean()) * 0.002 / TIME[-1]
    assert found == pytest.approx(0.5 * np.sum(drift**2) / NOISE**2, rel=0.15)


def test_a_command_that_comes_back_between_two_rows_is_not_periodic():
    """Its discrepancy comes back as much off, which adds up to many noises: 0.05 rows every 235, within the usual tolerance."""
    phase = 2 * np.pi * np.arange(len(TIME)) / 234.95
    command, error = 10.0 * np.sin(phase), 0.3 * np.sin(phase) ** 3 - 0.2 * np.cos(3 * phase)
    assert period_of(command[:, None]) == 235
    _, _, _, [(_, known, _)] = with_clean([record(np.zeros(len(TIME)), 1, command, error)], MODEL, 0.0, CONFIGURATION, ())
    assert by_periods(known, replace(known.problem, sigma=np.array([0.1 * NOISE]))) is None


def test_what_comes_back_and_noise_are_white_together():
    """Against the definition: variance 1 / weight of the mean over the periods, 1 of what they differ by."""
    weight, random = 1e-4, np.random.default_rng(2)
    error = PeriodicError((50,), weight, np.array([1.0]))
    shape = random.standard_normal((50, 1, 400)) / np.sqrt(weight)
    drawn = np.tile(shape, (6, 1, 1))[:, 0] + random.standard_normal((300, 400))
    white = np.stack([error.whitened(0, column[:, None])[:, 0] for column in drawn.T], axis=1)
    assert np.std(white[50:]) == pytest.approx(np.sqrt(1.0 + weight / 5 + 4 / 5), rel=0.02)
    back = error.whitened(0, white[:, :1], inverse=True)
    np.testing.assert_allclose(back, drawn[:, :1], rtol=1e-9)
    np.testing.assert_allclose(error.between(0, np.tile(shape[:, :, 0], (6, 1))), 0.0, atol=1e-9)
