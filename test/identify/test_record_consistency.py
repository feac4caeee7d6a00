# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Records of two plants of one gain are told apart by what is left between their common model and each of them."""

from __future__ import annotations

import numpy as np
import pytest

from hyst_control.base.config_files import config_path
from hyst_control.identify.assess.record_consistency import disagreements
from hyst_control.model_file import load_model, simulate
from hyst_control.records.excitation.excitation import build
from hyst_control.records.record import sampled_record

MODEL = load_model(config_path("models/pea_hampi.yaml"))
STEP = MODEL.sample_time


def record(name, late=0, gain=1.0, highest=60.0, kind="diagnostic", seed=0):
    """A record of the model's plant, of one whose answer comes some samples later, or of one of another gain."""
    shape = {"duration": 0.6, "band": 400.0} if kind == "diagnostic" else {"hold": 0.02, "count": 30}
    command = build({"signal": kind, "lowest": 0.0, "highest": highest, **shape}, STEP)
    measured = gain * simulate(MODEL, command, STEP)
    measured = np.concatenate([np.repeat(measured[:1], late, axis=0), measured[: len(measured) - late]])
    noise = 0.003 * np.random.default_rng(seed).normal(size=measured.shape)
    return sampled_record(name, command, measured + noise, STEP, ("x",), "um", "zoh", "settled")


def test_records_of_one_plant_agree():
    assert not disagreements(MODEL, [record("one"), record("again", seed=1), record("steps", kind="steps", seed=2)])
    assert not disagreements(MODEL, [record("one")])


@pytest.mark.parametrize("changes", [{"late": 3}, {"gain": 1.15}])
def test_records_of_two_plants_of_like_gain_do_not(changes):
    [found] = disagreements(MODEL, [record("one"), record("other", seed=1, **changes)])
    assert found.records == ("one", "other") and found.axis == "x" and "one and other: x: they differ by" in found.text()
    if "late" in changes:  # |1 - exp(-i w tau)|, largest at the upper end of the excited band
        assert found.frequency > 200.0
        np.testing.assert_allclose(found.difference, 2 * np.pi * found.frequency * 3 * STEP, rtol=0.4)
    else:
        np.testing.assert_allclose(found.difference, 0.15, atol=0.02)


def test_records_of_unlike_range_are_not_compared():
    assert not disagreements(MODEL, [record("one"), record("small", late=3, highest=30.0)])
