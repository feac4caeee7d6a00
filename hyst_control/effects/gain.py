# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A gain other than the model's, in amplifier, piezo or sensor."""

from __future__ import annotations

from hyst_control.chain.memoryless import Gain
from hyst_control.chain.parameter import ScalarPerAxis
from hyst_control.chain.stage import frozen, thawed
from hyst_control.effects.effect import Effect, Parameter


def factor(gain: ScalarPerAxis) -> ScalarPerAxis:
    """1 + gain, axis by axis."""
    value = frozen(gain)
    return [1.0 + item for item in thawed(value)] if isinstance(value, tuple) else float(1.0 + value)


EFFECT = Effect(
    "gain",
    "sensor",
    "The gain of amplifier, piezo or sensor is 1 + gain times the model's.",
    lambda _: (Parameter("gain", "", 0.0, (0.01,), -0.8, 4.0, 0.03),),
    lambda values, around: Gain(factor(values["gain"])),
    also_at=("drive",),
    separate_sizes=True,
    static=True,
    phrase="a gain error of {gain}",
)
