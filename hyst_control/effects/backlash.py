"""Play behind the mechanics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from hyst_control.chain.parameter import ScalarPerAxis, scalar
from hyst_control.chain.prandtl_ishlinskii import PlayOperator
from hyst_control.chain.stage import Filter, Sampling, Stage, register
from hyst_control.effects.effect import Effect, Parameter


@register
@dataclass(frozen=True)
class Backlash(Stage):
    """Follows its input with a play of `half_width` (measurement unit) to either side; starts from 0 like every play."""

    name: ClassVar[str] = "backlash"
    place: ClassVar[str] = "motion"
    half_width: ScalarPerAxis = scalar("measurement unit", "half of the play", lower=0.0)

    def filter(self, sampling: Sampling) -> Filter:
        return PlayOperator(self.half_width).filter(sampling)


EFFECT = Effect(
    "backlash",
    "motion",
    "Something between mechanics and sensor has play.",
    lambda around: (
        Parameter("half_width", "unit", 0.0, (0.002 * around.stroke,), 0.0, 0.05 * around.stroke, 0.01 * around.stroke),
    ),
    lambda values, around: Backlash(values["half_width"]),
)
