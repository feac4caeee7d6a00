"""What stages with random numbers share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hyst_control.chain.stage import Array, Filter, Sampling, Stage, per_axis_scalar, require_positive
from hyst_control.errors import InputError


@dataclass(frozen=True)
class RandomStage(Stage):
    """A stage that draws from a generator of its own, which starts at `seed` whenever the stage is settled."""

    commutes_with_delay: ClassVar[bool] = False


def check_seed(seed: object) -> None:
    """Raise `InputError` unless the seed is a whole number, not negative."""
    if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
        raise InputError(f"seed: {seed!r} is not a whole number, zero or more")


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
        return np.asarray(value, dtype=float) + self.rms * self.draw(1)[0]

    def process(self, block: Array) -> Array:
        return block + self.rms * self.draw(len(block))


def noise_level(stage: Stage, sampling: Sampling) -> Array:
    """rms (A,) of a noise stage."""
    return per_axis_scalar(stage.rms, sampling.axes, "rms")


def check_noise(stage: Stage) -> None:
    """Raise `InputError` unless rms and seed make sense."""
    require_positive(stage.rms, "rms", "(measurement unit)", zero_allowed=True)
    check_seed(stage.seed)
