# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Diagnosis of a model's own record: a linear model of a plant whose amplifier saturates on one side."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from hyst_control.diagnose.workflow import diagnosed
from hyst_control.identify.workflow import identify_records
from hyst_control.records.record import Record, Signal
from test.diagnose.conftest import all_but

STEP, ROWS, LIMIT, NOISE = 1e-3, 4000, 22.0, 0.005
WITHOUT = all_but(
    *("saturation", "output_saturation", "sensor_nonlinearity", "dead_zone", "hysteresis_width", "creep", "gain", "slew_limit"),
    *("backlash", "delay", "sensor_lowpass"),
)


def record() -> Record:
    """A lag of 60 Hz behind an amplifier that ends at `LIMIT`."""
    random, time = np.random.default_rng(0), STEP * np.arange(ROWS)
    waves = sum(np.sin(2 * np.pi * f * time + random.uniform(0.0, 6.28)) for f in np.arange(0.5, 20.0, 0.5))
    command = 20.0 + 8.0 * waves / np.max(np.abs(waves))
    keep = np.exp(-STEP * 2 * np.pi * 60.0)
    driven = np.minimum(command, LIMIT)
    moved, _ = lfilter([0.0, 1.0 - keep], [1.0, -keep], driven, zi=[keep * driven[0]])
    measured = moved + NOISE * random.standard_normal(ROWS)
    return Record(
        {"command": Signal(time, command[:, None], ("x",), "V"), "measurement": Signal(time, measured[:, None], ("x",), "um")},
        "record",
    )


def test_what_a_linear_model_lacks_is_no_error_of_its_own():
    own = record()
    model = identify_records([own], "linear").model
    assert float(np.max(model.discrepancy["rms"])) > 10.0 * NOISE
    stated, _, _ = diagnosed([own], model, cache=False, without=WITHOUT)
    assert stated["verdict"] == "no_gap"  # as the file states: its own error
    lacks, _, _ = diagnosed([own], model, cache=False, without=WITHOUT, own_records=True)
    assert lacks["verdict"] != "no_gap"
    effects = {effect["name"]: effect["parameters"] for effect in lacks["effects"]}
    assert abs(effects["saturation"]["upper"]["value"] - LIMIT) < 0.2
    assert lacks["effects"][0]["name"] == "saturation"
