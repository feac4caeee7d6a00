"""Creep of the piezo."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hyst_control.chain.linear import LinearStage, LinearSystem
from hyst_control.chain.parameter import ScalarPerAxis, scalar
from hyst_control.chain.stage import per_axis_scalar, register
from hyst_control.effects.effect import Effect, Parameter

BEGIN = 0.1
DECADES = 4
PER_DECADE = 3


@register
@dataclass(frozen=True)
class Creep(LinearStage):
    """Logarithmic creep: after a step of u the output grows on by about gamma log10(1 + t / 0.1 s) of it; gamma share per decade.

    A ladder of first-order lags, three per decade with time constants 0.1 s · 10^((i + 1/2)/3), i = 0 … 11, each gamma / 3: from
    0.5 s on gamma (log10(t / 0.1 s) + 0.25) within 0.03 gamma, to 40 s, then slower, to 4 gamma in the end.
    """

    name: ClassVar[str] = "creep"
    place: ClassVar[str] = "piezo"
    gamma: ScalarPerAxis = scalar("1/decade", "share of a step by which the output grows on")

    def systems(self, axes: int) -> list[LinearSystem]:
        count = DECADES * PER_DECADE
        rates = 1.0 / (BEGIN * 10.0 ** ((np.arange(count) + 0.5) / PER_DECADE))
        return [
            LinearSystem(-np.diag(rates), rates[:, None], np.full((1, count), gamma / PER_DECADE), np.ones((1, 1)), np.zeros(1))
            for gamma in per_axis_scalar(self.gamma, axes, "gamma")
        ]


EFFECT = Effect(
    "creep",
    "piezo",
    "After every step the piezo grows on with the logarithm of time.",
    lambda around: (Parameter("gamma", "", 0.0, (0.01,), -0.1, 0.1, 0.02),),
    lambda values, around: Creep(values["gamma"]),
)
