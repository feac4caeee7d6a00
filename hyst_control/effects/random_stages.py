# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Parts that stages with random numbers share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.chain.c_code.c_code import CCode
from hyst_control.chain.parameter import ScalarPerAxis, count, scalar
from hyst_control.chain.stage import Filter, Role, Stage
from hyst_control.effects.effect import Effect, Parameter, RecordCheck


@dataclass(frozen=True)
class RandomStage(Stage):
    """A stage that draws from a generator of its own, which starts at a seed whenever the stage is settled."""

    ROLES: ClassVar[Role] = Role.CHANGES_WITH_TIME


@dataclass(frozen=True)
class NoiseStage(RandomStage):
    """Additive noise of a level."""

    place: ClassVar[str] = "adc"
    rms: ScalarPerAxis = scalar("measurement unit", "level of the noise", lower=0.0)
    seed: int = count("of the generator", default=0)


RANDOM = "draws random numbers, which belong to a simulation: leave the stage out of what is exported"


class NoiseFilter(Filter):
    """Adds rms (A,) times the unit noise (N, A) of `draw`, which `begin` starts anew."""

    def __init__(self, rms: Array, seed: int, hold: str) -> None:
        self.hold = hold
        self.rms, self.seed = rms, seed

    def begin(self) -> None:
        """Start the noise anew."""
        self.generator = np.random.default_rng(self.seed)

    def draw(self, count: int) -> Array:
        """Unit noise (count, A)."""
        raise NotImplementedError

    def settle(self, value: Array) -> Array:
        self.begin()
        return np.asarray(np.asarray(value, dtype=float) + self.rms * self.draw(1)[0])

    def process(self, block: Array) -> Array:
        return block + self.rms * self.draw(len(block))

    def c_code(self) -> CCode:
        raise InputError(f"{type(self).__name__}: {RANDOM}")


def noise_effect(stage: type[NoiseStage], meaning: str, check: RecordCheck, phrase: str) -> Effect:
    """Effect of a noise, which a check of the record finds and measures."""
    return Effect(
        stage.name,
        stage.place,
        meaning,
        lambda around: (Parameter("rms", "unit", 0.0, (0.002 * around.stroke,), 0.0, 0.2 * around.stroke, 0.01 * around.stroke),),
        lambda values, around: stage(values["rms"], values.get("seed", 0)),
        waveform=False,
        record_check=check,
        phrase=phrase,
    )
