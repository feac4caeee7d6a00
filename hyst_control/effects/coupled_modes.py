# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Further responses of coupled mechanics, from every input to every sensor, in modes that they share."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hyst_control.base.errors import InputError
from hyst_control.chain.linear.linear_system import LinearSystem, block_diagonal, stacked
from hyst_control.chain.parameter import AllAxes, all_axes
from hyst_control.chain.stage import register
from hyst_control.effects.coupled_resonance import CoupledModifier


@register
@dataclass(frozen=True)
class CoupledModes(CoupledModifier):
    """Adds S + Σ (P ω² + V ω s) / (s² + 2 damping ω s + ω²), a sum over modes, to the mechanics before it; ω = 2π frequency (Hz).

    S: `static`, [output][input]; P: `in_phase`, V: `quadrature`, both [mode][output][input], in the mechanics' output per its input. A
    damping above 1 is two real poles. A chain without mechanics has G = 1 behind what it has.
    """

    name: ClassVar[str] = "coupled_modes"
    equation: ClassVar[str] = (
        r"\Delta G(s) = S + \sum_m \frac{P_m \omega_m^2 + V_m \omega_m s}{s^2 + 2 \zeta_m \omega_m s + \omega_m^2}, \quad "
        r"\omega_m = 2 \pi\, \mathrm{frequency}_m, \quad \zeta_m = \mathrm{damping}_m"
    )
    place: ClassVar[str] = "mechanics"
    frequency: AllAxes = all_axes("Hz", "by mode", 1, above=0.0)
    damping: AllAxes = all_axes("", "by mode", 1, above=0.0)
    in_phase: AllAxes = all_axes("output unit / input unit", "P, [mode][output][input]", 3)
    quadrature: AllAxes = all_axes("output unit / input unit", "V, [mode][output][input]", 3)
    static: AllAxes = all_axes("output unit / input unit", "S, [output][input]", 2)

    def check_shapes(self, axes: int) -> None:
        modes = len(np.atleast_1d(np.array(self.frequency, dtype=float)))
        due = {"damping": (modes,), "in_phase": (modes, axes, axes), "quadrature": (modes, axes, axes), "static": (axes, axes)}
        for field, shape in due.items():
            if np.shape(getattr(self, field)) != shape:
                raise InputError(
                    f"{field}: has shape {np.shape(getattr(self, field))}, {shape} is due for {modes} modes of {axes} axes"
                )

    def changed(self, systems: list[LinearSystem], axes: int) -> list[LinearSystem]:
        whole, eye = stacked(systems), np.eye(axes)
        states, entering, leaving = [], [], []
        values = (np.array(getattr(self, name), dtype=float) for name in ("frequency", "damping", "in_phase", "quadrature"))
        for frequency, damping, in_phase, quadrature in zip(*values, strict=True):
            driven = np.any(in_phase, axis=0) | np.any(quadrature, axis=0)
            w, inputs = 2 * np.pi * frequency, eye[driven]
            # A mode per input, in position and velocity / ω.
            states.append(np.kron(np.eye(len(inputs)), [[0.0, w], [-w, -2.0 * damping * w]]))
            entering.append(np.kron(inputs, [[0.0], [w]]))
            leaving.append(np.stack([in_phase[:, driven], quadrature[:, driven]], axis=2).reshape(axes, -1))
        return [
            LinearSystem(
                block_diagonal(whole.A, *states),
                np.vstack([whole.B, *entering]),
                np.hstack([whole.C, *leaving]),
                whole.D + np.array(self.static, dtype=float),
                whole.bias,
            )
        ]
