# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Noise that grows towards low frequencies."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numba import njit

from hyst_control.base.arrays import Array
from hyst_control.chain.stage import Filter, Sampling, per_axis_scalar, register
from hyst_control.effects.effect import RecordCheck
from hyst_control.effects.random_stages import NoiseFilter, NoiseStage, noise_effect

LOWEST = 0.03
PER_DECADE = 3


@register
@dataclass(frozen=True)
class FlickerNoise(NoiseStage):
    """Noise whose power density falls as 1/f from 0.03 Hz to half the sampling rate; `rms` (measurement unit) over all of it.

    A sum of low-passed white noises of equal power whose corners are a third of a decade apart, from a generator with `seed`.
    """

    name: ClassVar[str] = "flicker_noise"

    def filter(self, sampling: Sampling) -> Filter:
        return FlickerFilter(per_axis_scalar(self.rms, sampling.axes, "rms"), self.seed, sampling)


class FlickerFilter(NoiseFilter):
    """Streaming `FlickerNoise`."""

    def __init__(self, rms: Array, seed: int, sampling: Sampling) -> None:
        super().__init__(rms, seed, sampling.hold)
        decades = max(np.log10(0.5 / sampling.sample_time / LOWEST), 0.0)
        corners = LOWEST * 10.0 ** (np.arange(int(decades * PER_DECADE) + 1) / PER_DECADE)
        self.keep = np.exp(-2 * np.pi * corners * sampling.sample_time)
        self.state = np.zeros((len(rms), len(corners)))

    def begin(self) -> None:
        super().begin()
        self.state = self.generator.standard_normal(self.state.shape)

    def draw(self, count: int) -> Array:
        output = np.empty((count, len(self.rms)))
        draws = self.generator.standard_normal((count, *self.state.shape))
        sum_of_lowpassed(draws, self.keep, np.sqrt(1.0 - self.keep**2), self.state, output)
        return np.asarray(output / np.sqrt(len(self.keep)))


@njit(cache=True, error_model="numpy")
def sum_of_lowpassed(draws: Array, keep: Array, fresh: Array, state: Array, output: Array) -> None:
    """draws (N, A, n); keep, fresh (n,); state (A, n) is updated; output (N, A)."""
    for row in range(draws.shape[0]):
        for axis in range(draws.shape[1]):
            total = 0.0
            for i in range(keep.size):
                state[axis, i] = keep[i] * state[axis, i] + fresh[i] * draws[row, axis, i]
                total += state[axis, i]
            output[row, axis] = total


EFFECT = noise_effect(
    FlickerNoise,
    "The measurement has noise that grows towards low frequencies.",
    RecordCheck.FALLING_SPECTRUM,
    "1/f noise of {rms} rms",
)
