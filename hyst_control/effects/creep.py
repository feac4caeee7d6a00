# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Creep of the piezo."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hyst_control.chain.linear.linear_stages import LinearStage, LinearSystem
from hyst_control.chain.parameter import ScalarPerAxis, scalar
from hyst_control.chain.stage import per_axis_scalars, register
from hyst_control.effects.effect import Effect, Parameter, Surroundings

COUNT = 12  # Lags of the ladder


@register
@dataclass(frozen=True)
class Creep(LinearStage):
    """Logarithmic creep: after a step of u the output grows on by about gamma log10(1 + t / begin) of it; gamma share per decade.

    A ladder of 12 first-order lags of gamma · decades / 12 each, whose time constants begin · 10^((i + 1/2) decades / 12), i = 0 … 11,
    lie evenly in `decades` decades: with four of them from 0.1 s on it is gamma (log10(t / 0.1 s) + 0.25) within 0.03 gamma from 0.5 s
    to 40 s, then slower, to 4 gamma in the end. Half a decade is hardly wider than one relaxation.
    """

    name: ClassVar[str] = "creep"
    equation: ClassVar[str] = (
        r"y(t) \approx \left(1 + \mathrm{gamma}\, \log_{10}\left(1 + \frac{t}{\mathrm{begin}}\right)\right) u \quad "
        r"\text{after a step of } u \text{ at } t = 0"
    )
    place: ClassVar[str] = "piezo"
    gamma: ScalarPerAxis = scalar("1/decade", "share of a step by which the output grows on")
    begin: ScalarPerAxis = scalar("s", "shortest time", default=0.1, above=0.0)
    decades: ScalarPerAxis = scalar(
        "", "from the shortest time to the longest, decimal logarithm", default=4.0, above=0.0, upper=20.0
    )

    def systems(self, axes: int) -> list[LinearSystem]:
        steps = (np.arange(COUNT) + 0.5) / COUNT
        found = []
        for gamma, begin, decades in zip(*per_axis_scalars(self, axes, "gamma", "begin", "decades"), strict=True):
            rates = 1.0 / (begin * 10.0 ** (decades * steps))
            output = np.full((1, COUNT), gamma * decades / COUNT)
            found.append(LinearSystem(-np.diag(rates), rates[:, None], output, np.ones((1, 1)), np.zeros(1)))
        return found


def parameters(around: Surroundings) -> tuple[Parameter, ...]:
    """Size, and the span of time constants: of no ladder the record shows more than its length and sampling."""
    least, most = 10.0 * around.sample_time, 2.0 * around.duration
    starts = tuple(float(np.clip(begin, least, most)) for begin in (0.1, 0.01, 0.3 * around.duration))
    return (
        Parameter("gamma", "", 0.0, (0.01, 0.01, 0.03), -0.5, 0.5, 0.05),
        Parameter("begin", "s", starts[0], starts, least, most, 1.5, True),
        Parameter("decades", "", 4.0, (4.0, 4.0, 0.8), 0.4, 6.0, 2.0),
    )


EFFECT = Effect(
    "creep",
    "piezo",
    "After every step the piezo grows on, with the logarithm of time or with a few time constants.",
    parameters,
    lambda values, around: Creep(values["gamma"], values.get("begin", 0.1), values.get("decades", 4.0)),
    phrase="creep of {gamma} per decade",
)
