# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""More or less mass on the main mode."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, cast

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.chain.linear.linear_stages import LinearStage
from hyst_control.chain.linear.linear_system import THROUGH, LinearSystem, stacked, transfer_function_system
from hyst_control.chain.parameter import ScalarPerAxis, scalar
from hyst_control.chain.stage import Modifier, Stage, per_axis_scalars, register
from hyst_control.effects.effect import Effect, Parameter
from hyst_control.effects.modifiers import Changed
from hyst_control.effects.placement import mechanics_index

SEEN = 0.1  # A pair of poles belongs to an axis if its share of the static deflection is this much of the largest one's


@register
@dataclass(frozen=True)
class AddedMass(Modifier):
    """Gives the main mode of the mechanics before it the mass 1 + mass_ratio; stiffness and static gain stay.

    The damping constant grows by the share `damping`.

    The main mode s² + d s + k of an axis is its complex pair of poles of lowest frequency that carries a tenth of what the
    strongest one does, or where none is complex the two fastest real ones; d and k are divided by 1 + mass_ratio. Where
    the axes are coupled, the mode changes in everything that comes out on that axis.
    """

    name: ClassVar[str] = "added_mass"
    equation: ClassVar[str] = (
        r"\frac{1}{s^2 + d s + k} \to \frac{1}{s^2 + d' s + k'}, \quad d' = \frac{1 + \mathrm{damping}}{1 + "
        r"\mathrm{mass\_ratio}}\, d, \quad k' = \frac{k}{1 + \mathrm{mass\_ratio}}"
    )
    place: ClassVar[str] = "mechanics"
    mass_ratio: ScalarPerAxis = scalar("", "mass that is added, in that of the mode", above=-1.0)
    damping: ScalarPerAxis = scalar("", "growth of the damping constant", default=0.0, above=-1.0)

    def applied(self, before: tuple[Stage, ...], axes: int) -> tuple[Stage, ...]:
        index = mechanics_index(before)
        if index is None:
            raise InputError("added_mass: no mechanics before it (transfer function or continuous state space): put it behind them")
        if not any(values.any() for values in per_axis_scalars(self, axes, "mass_ratio", "damping")):
            return before
        return (*before[:index], Changed(cast(LinearStage, before[index]), self._heavier, self.name), *before[index + 1 :])

    def _heavier(self, systems: list[LinearSystem], axes: int) -> list[LinearSystem]:
        ratio, growth = per_axis_scalars(self, axes, "mass_ratio", "damping")
        if len(systems) == axes:
            return [_heavier(system, ratio[i : i + 1], growth[i : i + 1]) for i, system in enumerate(systems)]
        return [_heavier(systems[0], ratio, growth)]


def _heavier(system: LinearSystem, ratio: Array, growth: Array) -> LinearSystem:
    """The old mode canceled and the new one put in its place, behind the system, output by output."""
    ratios = []
    for output, (share, more) in enumerate(zip(ratio, growth, strict=True)):
        if not (share or more):
            ratios.append(THROUGH)
            continue
        damping, stiffness = main_mode(system, output)
        mode = np.array([1.0, damping, stiffness])
        ratios.append(transfer_function_system(mode, np.array([1.0 + share, (1.0 + more) * damping, stiffness])))
    return system.then(stacked(ratios))


def main_mode(system: LinearSystem, output: int) -> tuple[float, float]:
    """(d, k) of the main mode s² + d s + k from an axis' input to its output; raises `InputError` with fewer than two poles."""
    poles, vectors = np.linalg.eig(system.A)
    try:
        from_input = np.linalg.solve(vectors, system.B[:, output].astype(complex))
    except np.linalg.LinAlgError:
        from_input = np.ones(len(poles))  # poles that coincide have no modes of their own: all count alike
    share = np.abs(system.C[output] @ vectors * from_input / poles) if len(poles) else np.zeros(0)
    oscillating = np.flatnonzero(poles.imag > 1e-9 * np.abs(poles))
    if len(oscillating):
        seen = oscillating[share[oscillating] >= SEEN * share[oscillating].max()]
        pole = poles[seen[np.argmin(np.abs(poles[seen]))]]
        return float(-2.0 * pole.real), float(abs(pole) ** 2)
    if len(poles) < 2:
        raise InputError("added_mass: the mechanics before it have fewer than two poles, there is no mass in them")
    fastest = np.sort(poles.real)[:2]
    return float(-fastest.sum()), float(fastest.prod())


EFFECT = Effect(
    "added_mass",
    "mechanics",
    "The moved mass is another one: the main mode is slower or faster, its stiffness kept.",
    lambda around: (
        Parameter("mass_ratio", "", 0.0, (0.02, 0.2, 1.0, -0.15, 2.5), -0.6, 3.0, 0.15),
        Parameter("damping", "", 0.0, (0.0,), -0.6, 1.0, 0.1),
    ),
    lambda values, around: AddedMass(values["mass_ratio"], values.get("damping", 0.0)),
    phrase="a main mode with {mass_ratio} of its mass and {damping} of its damping added",
)
