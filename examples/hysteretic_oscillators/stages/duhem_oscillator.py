"""Duhem oscillator: branches of any shape, given by a table (Visintin, Differential Models of Hysteresis, 1994, chapter V)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hyst_control.base.errors import InputError
from hyst_control.chain.parameter import Scattering, VectorPerAxis, vector
from hyst_control.chain.stage import depth, per_axis, register
from hysteretic_oscillators.stages.hysteretic_oscillator import HystereticOscillator, Law


@register
@dataclass(frozen=True)
class DuhemOscillator(HystereticOscillator):
    """Duhem oscillator, from command u to displacement y: mechanics with a hysteretic force whose branches are a table.

    mass ÿ + damping ẏ + stiffness y + z = u,  dz/dy = rising(z) while y rises and falling(z) while it falls, per axis. Both functions
    are straight between the knots and beyond them. With a knot at 0 and one on either side of it, they contain the Bouc-Wen law of
    exponent 1.
    """

    name: ClassVar[str] = "duhem_oscillator"
    equation: ClassVar[str] = (
        r"\mathrm{mass}\, \ddot{y} + \mathrm{damping}\, \dot{y} + \mathrm{stiffness}\, y + z = u, \quad \frac{dz}{dy} = "
        r"\mathrm{rising}(z) \text{ for } \dot{y} > 0, \quad \mathrm{falling}(z) \text{ for } \dot{y} < 0"
    )
    knots: VectorPerAxis = vector("V", "forces z at which the slopes are given, increasing", scatter=Scattering.NONE)
    rising: VectorPerAxis = vector("V/measurement unit", "slope dz/dy at the knots while y rises")
    falling: VectorPerAxis = vector("V/measurement unit", "slope dz/dy at the knots while y falls")

    def check(self) -> None:
        self.laws(max(len(value) if depth(value) == 2 else 1 for value in (self.knots, self.rising, self.falling)))

    def laws(self, axes: int) -> list[Law]:
        tables = zip(*(per_axis(getattr(self, key), axes, 1, key) for key in ("knots", "rising", "falling")), strict=True)
        found = [Law(np.array([0.0, 0.0, 0.0, 1.0]), *table) for table in tables]
        for law in found:
            if len(law.knots) < 2 or np.any(np.diff(law.knots) <= 0):
                raise InputError(f"knots: must be at least two and increasing, got {law.knots.tolist()}")
            for key, values in (("rising", law.rising), ("falling", law.falling)):
                if len(values) != len(law.knots):
                    raise InputError(f"{key}: {len(values)} slopes for {len(law.knots)} knots: give one per knot")
        return found
