# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A load heavier than the stage itself: scipy's oscillator of more mass against a model of the empty stage."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import chirp, lsim

from hyst_control.chain import Chain
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.diagnose.workflow import diagnosed
from hyst_control.model_file import Model
from hyst_control.records.record import Record, Signal
from test.diagnose.conftest import all_but

RATE = 5000.0
RIVALS = (
    "added_mass",
    "resonance",
    "delay",
    "gain",
    "creep",
    "amplifier_lowpass",
    "sensor_lowpass",
    "cubic_stiffness",
    "dry_friction",
)


@pytest.mark.parametrize("ratio", [0.5, 2.5])
def test_a_load_of_more_than_the_moving_mass_is_named(ratio):
    mass, damping, stiffness = 1.0, 120.0, (2 * np.pi * 180.0) ** 2
    time = np.arange(6000) / RATE
    command = (
        40.0 + 30.0 * chirp(time, 1.0, time[-1], 400.0) * np.minimum(time / 0.05, 1.0) - 40.0 * np.maximum(1.0 - time / 0.05, 0.0)
    )
    loaded = ([0.1 * stiffness], [(1.0 + ratio) * mass, damping, stiffness])
    _, output, _ = lsim(loaded, command, time, interp=False)
    measured = output + 0.002 * np.random.default_rng(3).normal(size=len(time))
    signals = {
        "command": Signal(time, command[:, None], ("x",), "V"),
        "measurement": Signal(time, measured[:, None], ("x",), "um"),
    }
    chain = Chain((TransferFunction((0.1 * stiffness,), (mass, damping, stiffness)),))
    model = Model("stage", ("x",), {"command": "V", "measurement": "um"}, 1.0 / RATE, chain, noise={"sigma": 0.002})
    report, *_ = diagnosed([Record(signals, "loaded")], model, cache=False, without=all_but(*RIVALS))
    first = report["effects"][0]
    assert (report["verdict"], first["name"]) == ("effect", "added_mass")
    assert first["parameters"]["mass_ratio"]["value"] == pytest.approx(ratio, rel=0.03)
    assert first["shrink"] > 0.98
