# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A further mode that all axes of a plant take part in: driven by every input, seen by every sensor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, cast

import numpy as np

from hyst_control.base.errors import InputError
from hyst_control.chain.linear.linear_stages import LinearStage
from hyst_control.chain.linear.linear_system import LinearSystem, block_diagonal, stacked
from hyst_control.chain.parameter import AllAxes, all_axes
from hyst_control.chain.stage import Modifier, Role, Stage, register
from hyst_control.effects.modifiers import Changed
from hyst_control.effects.placement import with_mechanics


class CoupledModifier(Modifier):
    """A change of the mechanics before it that lets the axes drive each other."""

    ROLES: ClassVar[Role] = Role.MIXES_AXES

    def check_shapes(self, axes: int) -> None:
        """Raise `InputError` for coefficients that do not fit the number of axes."""

    def changed(self, systems: list[LinearSystem], axes: int) -> list[LinearSystem]:
        """The mechanics' systems with the change."""
        raise NotImplementedError

    def applied(self, before: tuple[Stage, ...], axes: int) -> tuple[Stage, ...]:
        self.check_shapes(axes)
        before, index = with_mechanics(before)
        together = ChangedTogether(cast(LinearStage, before[index]), self.changed, self.name)
        return (*before[:index], together, *before[index + 1 :])


@register
@dataclass(frozen=True)
class CoupledResonance(CoupledModifier):
    """Adds (P ω² + V ω s) / (s² + 2 damping ω s + ω²) to the mechanics before it, fed alike; ω = 2π frequency (Hz).

    P: `in_phase`, V: `quadrature`, both [output][input], in the mechanics' output per its input. V is what a mode has whose inputs and
    sensors are not in phase. A chain without mechanics has G = 1 behind what it has.
    """

    name: ClassVar[str] = "coupled_resonance"
    equation: ClassVar[str] = (
        r"\Delta G(s) = \frac{P \omega^2 + V \omega s}{s^2 + 2\, \mathrm{damping}\, \omega s + \omega^2}, \quad \omega = "
        r"2 \pi\, \mathrm{frequency}"
    )
    place: ClassVar[str] = "mechanics"
    frequency: float = all_axes("Hz", "of the mode", 0, above=0.0)
    damping: float = all_axes("", "of the mode", 0, above=0.0)
    in_phase: AllAxes = all_axes("output unit / input unit", "P, [output][input]", 2)
    quadrature: AllAxes = all_axes("output unit / input unit", "V, [output][input]", 2)

    def check_shapes(self, axes: int) -> None:
        for field in ("in_phase", "quadrature"):
            if np.shape(getattr(self, field)) != (axes, axes):
                raise InputError(f"{field}: shape {np.shape(getattr(self, field))} does not fit {axes} axes, give [output][input]")

    def changed(self, systems: list[LinearSystem], axes: int) -> list[LinearSystem]:
        whole = stacked(systems)
        w, eye = 2 * np.pi * float(self.frequency), np.eye(axes)
        # A mode per input, in position and velocity / ω.
        mode = np.kron(eye, [[0.0, w], [-w, -2.0 * float(self.damping) * w]])
        entering = np.kron(eye, [[0.0], [w]])
        leaving = np.stack([np.array(self.in_phase, dtype=float), np.array(self.quadrature, dtype=float)], axis=2)
        leaving = leaving.reshape(axes, 2 * axes)
        return [
            LinearSystem(
                block_diagonal(whole.A, mode), np.vstack([whole.B, entering]), np.hstack([whole.C, leaving]), whole.D, whole.bias
            )
        ]


class ChangedTogether(Changed):
    """A linear stage whose axes drive each other once it is changed."""

    ROLES: ClassVar[Role] = Changed.ROLES | Role.MIXES_AXES
