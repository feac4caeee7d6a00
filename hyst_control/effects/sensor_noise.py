# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""More white noise than the model states."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from hyst_control.base.arrays import Array
from hyst_control.chain.stage import Filter, Sampling, per_axis_scalar, register
from hyst_control.effects.effect import RecordCheck
from hyst_control.effects.random_stages import NoiseFilter, NoiseStage, noise_effect


@register
@dataclass(frozen=True)
class SensorNoise(NoiseStage):
    """White Gaussian noise of `rms` (measurement unit) on every sample and axis, from a generator with `seed`."""

    name: ClassVar[str] = "sensor_noise"

    def filter(self, sampling: Sampling) -> Filter:
        return WhiteFilter(per_axis_scalar(self.rms, sampling.axes, "rms"), self.seed, sampling.hold)


class WhiteFilter(NoiseFilter):
    """Streaming `SensorNoise`."""

    def draw(self, count: int) -> Array:
        return self.generator.standard_normal((count, len(self.rms)))


EFFECT = noise_effect(
    SensorNoise,
    "The measurement has more white noise than the model states.",
    RecordCheck.WHITE_SPECTRUM,
    "sensor noise of {rms} rms",
)
