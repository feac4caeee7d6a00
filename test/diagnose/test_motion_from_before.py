# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Records that begin amid a motion, beside a baseline record of the same command: what goes on from before takes no part of an effect."""

import numpy as np
import pytest

import hyst_control as hc
from hyst_control.chain import Chain
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.model_file import Model

RATE, COUNT, NOISE, GAIN, POLE = 2.0, 2000, 0.15, 20.0, 1 / 160.0


def level(command, start):
    """A slow level with an inflow that grows with its square as well, step by step: what the linear model below describes roughly."""
    left = np.exp(-POLE / RATE)
    levels, now = np.empty(len(command)), start
    for row, inflow in enumerate(GAIN * (command + 0.02 * (command - 5.0) ** 2)):
        levels[row] = now
        now = inflow + left * (now - inflow)
    return levels


@pytest.fixture(scope="module")
def tank():
    """Command, level, and a model with a pole that is too fast."""
    rng = np.random.default_rng(4)
    command = 5.0 + np.repeat(rng.uniform(-2.0, 2.0, COUNT // 50), 50)
    pole = 1.1 * POLE
    units = {"command": "V", "measurement": "um"}
    return (
        command,
        level(command, 90.0),
        Model("tank", ("x",), units, 1 / RATE, Chain((TransferFunction([GAIN * pole], [1.0, pole]),))),
    )


def measured(command, values, seed):
    return hc.from_arrays(
        command, values + np.random.default_rng(seed).normal(0.0, NOISE, len(values)), RATE, unit="um", hold="zoh"
    )


def test_the_gain_of_a_sensor_is_a_gain_and_no_drift(tank):
    command, levels, model = tank
    gap = hc.diagnose(measured(command, 1.04 * levels, 1), model, baseline=[measured(command, levels, 2)])
    (named,) = gap.document["effects"]
    assert (gap.verdict, named["name"]) == ("effect", "gain")
    assert named["parameters"]["gain"]["value"] == pytest.approx(0.04, abs=0.002)


def test_another_motion_from_before_is_no_effect(tank):
    command, levels, model = tank
    other = level(command, 93.0)
    assert np.ptp(other - levels) > 10.0 * NOISE
    assert hc.diagnose(measured(command, other, 1), model, baseline=[measured(command, levels, 2)]).verdict == "no_gap"


def test_a_slow_motion_from_before_is_no_turned_sign(tank):
    command, _, model = tank
    gap = hc.diagnose(measured(command, level(command, 40.0), 1), model)
    assert "sign" not in str(gap) and gap.document["gap"]["rms"] is not None
