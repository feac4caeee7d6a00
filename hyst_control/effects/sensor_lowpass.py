# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The sensor's bandwidth, behind the mechanics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from hyst_control.chain.stage import register
from hyst_control.effects.lowpass import Lowpass, lowpass_effect


@register
@dataclass(frozen=True)
class SensorLowpass(Lowpass):
    """A low-pass of the measurement: `order` equal ones in a row, or one of second order with another `damping`."""

    name: ClassVar[str] = "sensor_lowpass"


EFFECT = lowpass_effect(
    "sensor_lowpass",
    "sensor",
    "The sensor is slower than the model says: a low-pass of first or second order after the mechanics.",
    SensorLowpass,
    "a sensor low-pass at {cutoff}",
)
