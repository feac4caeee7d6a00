# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A discrepancy comes back with every period of the command: what the periods differ by is noise, or comes with time."""

from __future__ import annotations

import numpy as np
import pytest

from hyst_control.chain import Chain
from hyst_control.chain.memoryless import Gain
from hyst_control.diagnose.problem.periodic_error import PeriodicError
from hyst_control.diagnose.workflow import diagnosed
from hyst_control.model_file import Model
from hyst_control.records.record import Record, Signal
from test.diagnose.conftest import all_but

STEP, PERIOD, PERIODS, NOISE = 1e-3, 250, 8, 0.01
TIME = STEP * np.arange(PERIOD * PERIODS)
COMMAND = 10.0 * np.sin(2 * np.pi * TIME / (PERIOD * STEP))
ERROR = 0.3 * (COMMAND / 10.0) ** 3 - 0.2 * np.cos(6 * np.pi * TIME / (PERIOD * STEP))
"""What the model leaves on the healthy machine, 20 times the noise."""


def verdict(added: np.ndarray, seed: int) -> tuple[str, list[dict]]:
    stated = {"rms": [float(np.std(ERROR))], "correlation": 0.2}
    model = Model("m", ("x",), {"command": "V", "measurement": "um"}, STEP, Chain((Gain(1.0),)), "foh", discrepancy=stated)
    measured = COMMAND + ERROR + added + NOISE * np.random.default_rng(seed).standard_normal(len(TIME))
    signals = {
        "command": Signal(TIME, COMMAND[:, None], ("x",), "V"),
        "measurement": Signal(TIME, measured[:, None], ("x",), "um"),
    }
    document, _, _ = diagnosed([Record(signals, "new")], model, without=all_but("gain", "gain_drift", "delay"), cache=False)
    return document["verdict"], document["effects"]


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
