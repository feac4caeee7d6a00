# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Samples that repeat the one before."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.chain.c_code.c_code import CCode
from hyst_control.chain.parameter import ScalarPerAxis, count, scalar
from hyst_control.chain.stage import Filter, Sampling, per_axis_scalar, register
from hyst_control.effects.effect import Effect, Parameter, RecordCheck
from hyst_control.effects.random_stages import RANDOM, RandomStage


@register
@dataclass(frozen=True)
class HeldSamples(RandomStage):
    """Repeats the value before in a `fraction` of the samples, at random on every axis, from a generator with `seed`."""

    name: ClassVar[str] = "held_samples"
    place: ClassVar[str] = "transport"
    fraction: ScalarPerAxis = scalar("", "of the samples", lower=0.0, upper=1.0)
    seed: int = count("of the generator", default=0)

    def filter(self, sampling: Sampling) -> Filter:
        return HeldFilter(per_axis_scalar(self.fraction, sampling.axes, "fraction"), self.seed, sampling.hold)


class HeldFilter(Filter):
    """Streaming `HeldSamples`."""

    def __init__(self, fraction: Array, seed: int, hold: str) -> None:
        self.hold = hold
        self.fraction, self.seed = fraction, seed

    def settle(self, value: Array) -> Array:
        self.generator = np.random.default_rng(self.seed)
        self.last = np.array(value, dtype=float)
        return self.last.copy()

    def process(self, block: Array) -> Array:
        known = np.concatenate([self.last[None], block])
        fresh = self.generator.random(block.shape) >= self.fraction
        newest = np.maximum.accumulate(np.where(fresh, np.arange(1, len(block) + 1)[:, None], 0))
        output = np.take_along_axis(known, newest, axis=0)
        self.last = output[-1].copy() if len(block) else self.last
        return output

    def c_code(self) -> CCode:
        raise InputError(f"held_samples: {RANDOM}")


EFFECT = Effect(
    "held_samples",
    "transport",
    "Samples of the measurement repeat the one before.",
    lambda around: (Parameter("fraction", "", 0.0, (0.02,), 0.0, 0.9, 0.05),),
    lambda values, around: HeldSamples(values["fraction"], values.get("seed", 0)),
    waveform=False,
    record_check=RecordCheck.REPEATED_VALUES,
    phrase="repeated samples ({fraction} of all)",
)
