"""Samples that repeat the one before."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from hyst_control.chain.stage import Array, Filter, Sampling, per_axis_scalar, register, require_positive
from hyst_control.effects.effect import Effect, Parameter
from hyst_control.effects.random_stages import RandomStage, check_seed
from hyst_control.errors import InputError


@register
@dataclass(frozen=True)
class HeldSamples(RandomStage):
    """Repeats the value before in a `fraction` of the samples, at random on every axis, from a generator with `seed`."""

    name: ClassVar[str] = "held_samples"
    fraction: Any
    seed: int = 0

    def check(self) -> None:
        require_positive(self.fraction, "fraction", "", zero_allowed=True)
        if np.any(np.array(self.fraction) > 1.0):
            raise InputError(f"fraction: {self.fraction}: a share, 1 at most, is due")
        check_seed(self.seed)

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


EFFECT = Effect(
    "held_samples",
    "transport",
    "Samples of the measurement repeat the one before.",
    lambda around: (Parameter("fraction", "", 0.0, (0.02,), 0.0, 0.9, 0.05),),
    lambda values, around: HeldSamples(values["fraction"], values.get("seed", 0)),
    waveform=False,
)
