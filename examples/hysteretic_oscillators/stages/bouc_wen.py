"""Bouc-Wen oscillator (Bouc 1967; Wen, Journal of the Engineering Mechanics Division 102, 1976)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hyst_control.chain.parameter import ScalarPerAxis, scalar
from hyst_control.chain.stage import per_axis_scalars, register
from hysteretic_oscillators.stages.hysteretic_oscillator import HystereticOscillator, Law


@register
@dataclass(frozen=True)
class BoucWen(HystereticOscillator):
    """Bouc-Wen oscillator, from command u to displacement y: hysteresis inside the feedback of the mechanics.

    mass ÿ + damping ẏ + stiffness y + z = u,  ż = alpha ẏ - (beta |ẏ| |z|^(exponent - 1) z + gamma ẏ |z|^exponent), per axis.
    For beta + gamma > 0 the force z on a long way tends to (alpha / (beta + gamma))^(1 / exponent). Small loops are those of a spring
    stiffness + alpha.
    """

    name: ClassVar[str] = "bouc_wen"
    equation: ClassVar[str] = (
        r"\mathrm{mass}\, \ddot{y} + \mathrm{damping}\, \dot{y} + \mathrm{stiffness}\, y + z = u, \quad \dot{z} = "
        r"\mathrm{alpha}\, \dot{y} - \mathrm{beta}\, |\dot{y}|\, |z|^{\mathrm{exponent} - 1} z - \mathrm{gamma}\, "
        r"\dot{y}\, |z|^{\mathrm{exponent}}"
    )
    alpha: ScalarPerAxis = scalar("V/measurement unit", "stiffness of the hysteretic force for small motions", lower=0.0)
    beta: ScalarPerAxis = scalar("V^(1-exponent)/measurement unit", "of the term that opposes the motion: width of the loops")
    gamma: ScalarPerAxis = scalar(
        "V^(1-exponent)/measurement unit", "of the term that bends both branches alike: softer (> 0) or harder (< 0)", default=0.0
    )
    exponent: ScalarPerAxis = scalar("", "sharpness of the bend", lower=1.0, upper=50.0, default=1.0)

    def laws(self, axes: int) -> list[Law]:
        formulas = np.stack(per_axis_scalars(self, axes, "alpha", "beta", "gamma", "exponent"), axis=1)
        none = np.zeros(0)
        return [Law(np.ascontiguousarray(formula), none, none, none) for formula in formulas]
