"""Creep operators: parts of a motion that arrive late, each by a first-order lag of its own.

    y = (1 - Σ c_k) u + Σ c_k L_k[u],    L_k = 1 / (τ_k s + 1)

A grid of time constants τ_k stands for logarithmic creep over as many decades as it spans, and for the relaxation of a viscoelastic stage.
Behind Prandtl-Ishlinskii operators it is the model of K. Kuhnen and H. Janocha (Compensation of the creep and hysteresis effects of
piezoelectric actuators with inverse systems, Actuator 98, 1998) with one creep law for all operators. The static gain is 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hyst_control.base.errors import InputError
from hyst_control.chain.linear.linear_stages import LinearStage, LinearSystem
from hyst_control.chain.parameter import Scattering, VectorPerAxis, vector
from hyst_control.chain.stage import depth, per_axis, register


@register
@dataclass(frozen=True)
class CreepOperators(LinearStage):
    """Parts of the motion that arrive late: y = (1 - Σ shares) u + Σ shares · u behind a lag of its time each."""

    name: ClassVar[str] = "creep_operators"
    equation: ClassVar[str] = (
        r"y = \left(1 - \sum_k \mathrm{shares}_k\right) u + \sum_k \frac{\mathrm{shares}_k}{1 + \mathrm{times}_k\, s}\, u"
    )
    place: ClassVar[str] = "piezo"
    unit_gain: ClassVar[bool] = True
    times: VectorPerAxis = vector("s", "time constants of the lags", above=0.0, scatter=Scattering.NONE)
    shares: VectorPerAxis = vector("", "part of the motion that each of them delays", scatter=Scattering.RELATIVE)

    def check(self) -> None:
        axes = max(len(value) if depth(value) == 2 else 1 for value in (self.times, self.shares))
        for times, shares in zip(per_axis(self.times, axes, 1, "times"), per_axis(self.shares, axes, 1, "shares"), strict=True):
            if len(times) != len(shares):
                raise InputError(f"shares: {len(shares)} shares for {len(times)} times: give one each")

    def systems(self, axes: int) -> list[LinearSystem]:
        found = []
        for times, shares in zip(per_axis(self.times, axes, 1, "times"), per_axis(self.shares, axes, 1, "shares"), strict=True):
            rates = 1.0 / times
            direct = np.array([[1.0 - shares.sum()]])
            found.append(LinearSystem(-np.diag(rates), rates[:, None], shares[None, :], direct, np.zeros(1)))
        return found
