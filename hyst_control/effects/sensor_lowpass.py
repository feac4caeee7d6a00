# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The sensor's bandwidth, behind the mechanics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from hyst_control.chain.stage import register
from hyst_control.effects.effect import Effect
from hyst_control.effects.lowpass import Lowpass, lowpass_parameters, lowpass_values, lowpass_variants


@register
@dataclass(frozen=True)
class SensorLowpass(Lowpass):
    """A low-pass of the measurement; see `Lowpass`."""

    name: ClassVar[str] = "sensor_lowpass"
    equation: ClassVar[str] = (
        r"y = \left(\frac{1}{1 + s / (2 \pi\, \mathrm{cutoff})}\right)^{\mathrm{order}} u \quad \text{for } "
        r"\mathrm{damping} = 1"
    )


EFFECT = Effect(
    "sensor_lowpass",
    "sensor",
    "The sensor is slower than the model says: a low-pass of first or second order after the mechanics.",
    lowpass_parameters,
    lambda values, around: SensorLowpass(**lowpass_values(values)),
    variants=lowpass_variants,
    separating_record="the amplifier's output voltage",
    phrase="a sensor low-pass at {cutoff}",
)
