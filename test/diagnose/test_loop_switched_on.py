# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Records that begin when a loop is switched on: the first command jumps from 0 V, behind a delay, and effects begin amid a motion too.

The machine is made sample by sample at a rate sixteen times as high, of a delay, a mode and the effect.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

import hyst_control as hc
from hyst_control.chain import Chain
from hyst_control.chain.linear.linear_stages import Delay, TransferFunction
from hyst_control.model_file import Model

RATE, FINE, NOISE = 5000.0, 16, 0.004
GAIN, DELAY, ROOT, DAMPING = 0.1, 3e-4, 2 * np.pi * 400.0, 0.05
BOTTOM = (1.0, 2 * DAMPING * ROOT, ROOT**2)


def measured(command, delay=DELAY, lowpass=None, bottom=BOTTOM):
    """The output at each sample, from rest at 0 V."""
    fine = np.concatenate([np.zeros(round(delay * RATE * FINE)), np.repeat(command, FINE)])[: FINE * len(command)]
    for top, low in (((GAIN * bottom[-1],), bottom), *([((lowpass,), (1.0, lowpass))] if lowpass else [])):
        numerator, denominator, _ = cont2discrete((top, low), 1.0 / (RATE * FINE), "zoh")
        fine = lfilter(np.ravel(numerator), denominator, fine)
    return fine[::FINE] + NOISE * np.random.default_rng(1).standard_normal(len(command))


@pytest.fixture(scope="module")
def command():
    random, time = np.random.default_rng(2), np.arange(8000) / RATE
    return 60.0 + sum(6.0 * np.sin(2 * np.pi * f * time + random.uniform(0.0, 6.0)) for f in random.uniform(1.0, 60.0, 6))


@pytest.fixture(scope="module")
def model():
    chain = Chain((Delay(DELAY), TransferFunction((GAIN * BOTTOM[-1],), BOTTOM)))
    units, tolerance = {"command": "V", "measurement": "um"}, {"num": 1e-4, "den": 1e-4, "tau": 1e-4}
    return Model("stage", ("x",), units, 1.0 / RATE, chain, noise={"sigma": NOISE}, tolerance=tolerance)


@pytest.mark.parametrize(
    ("effect", "accepted"),
    [
        ({}, None),
        ({"delay": DELAY + 4e-4}, {"delay"}),
        ({"lowpass": 2 * np.pi * 150.0}, {"sensor_lowpass", "amplifier_lowpass"}),
        ({"bottom": (1.0, 2 * DAMPING * 0.9 * ROOT, (0.9 * ROOT) ** 2)}, {"added_mass"}),
    ],
)
def test_the_switching_on_is_no_effect_and_hides_none(command, model, effect, accepted):
    gap = hc.diagnose(hc.from_arrays(command, measured(command, **effect), RATE, hold="zoh"), model, verbose=False)
    assert gap.verdict in (("no_gap",) if accepted is None else ("effect", "ambiguous"))
    assert {each["name"] for each in gap.document["effects"]} <= (accepted or set())
    if accepted is None:  # nothing of the jump counts
        assert gap.document["gap"]["rms"] < 1.2 * NOISE
