# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A further mode beside the mechanics."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, cast

import numpy as np

from hyst_control.chain.linear.linear_stages import LinearStage
from hyst_control.chain.linear.linear_system import LinearSystem, block_diagonal
from hyst_control.chain.parameter import ScalarPerAxis, declared, scalar
from hyst_control.chain.stage import Modifier, Stage, frozen, per_axis_scalars, register
from hyst_control.effects.coupled_resonance import CoupledResonance
from hyst_control.effects.effect import Effect, Parameter, Surroundings, Values
from hyst_control.effects.modifiers import Changed
from hyst_control.effects.placement import with_mechanics

STEP = 1.065  # Ratio of the frequencies at which a search begins: about the width of a mode as damped as the starts are


@register
@dataclass(frozen=True)
class Resonance(Modifier):
    """Adds G(0) ((gain ω² + quadrature ω s) / (s² + 2 damping ω s + ω²) + static) to the mechanics G before it; ω = 2π frequency (Hz).

    quadrature is what a mode has whose drive and sensor are not in phase; static -gain is a mode without static deflection. A
    chain without mechanics has G = 1 behind what it has.
    """

    name: ClassVar[str] = "resonance"
    equation: ClassVar[str] = (
        r"\Delta G(s) = G(0) \left(\frac{\mathrm{gain}\, \omega^2 + \mathrm{quadrature}\, \omega s}{s^2 + 2\, "
        r"\mathrm{damping}\, \omega s + \omega^2} + \mathrm{static}\right), \quad \omega = 2 \pi\, \mathrm{frequency}"
    )
    place: ClassVar[str] = "mechanics"
    frequency: ScalarPerAxis = scalar("Hz", "of the mode", above=0.0)
    damping: ScalarPerAxis = scalar("", "of the mode", above=0.0)
    gain: ScalarPerAxis = scalar("", "of the mode, in the static gain of the mechanics")
    quadrature: ScalarPerAxis = scalar("", "of the mode's velocity / ω, likewise", default=0.0)
    static: ScalarPerAxis = scalar("", "direct part beside it, likewise", default=0.0)

    def applied(self, before: tuple[Stage, ...], axes: int) -> tuple[Stage, ...]:
        before, index = with_mechanics(before)
        return (*before[:index], Changed(cast(LinearStage, before[index]), self._with_mode, self.name), *before[index + 1 :])

    def _with_mode(self, systems: list[LinearSystem], axes: int) -> list[LinearSystem]:
        frequency, damping, gain = per_axis_scalars(self, axes, "frequency", "damping", "gain")
        quadrature, static = per_axis_scalars(self, axes, "quadrature", "static")
        changed = []
        first = 0
        for system in systems:
            own = range(first, first + len(system.D))
            first += len(system.D)
            rates = 2 * np.pi * frequency[list(own)]
            # A mode in position and velocity / w: the input enters the velocity with w, the position is the output.
            blocks = [np.array([[0.0, w], [-w, -2.0 * damping[i] * w]]) for w, i in zip(rates, own, strict=True)]
            b = np.zeros((2 * len(own), len(own)))
            c = np.zeros((len(own), 2 * len(own)))
            for row, i in enumerate(own):
                b[2 * row + 1, row] = rates[row]
                c[row, 2 * row : 2 * row + 2] = gain[i], quadrature[i]
            changed.append(
                LinearSystem(
                    block_diagonal(system.A, *blocks),
                    np.vstack([system.B, b @ system.static_gain()]),
                    np.hstack([system.C, c]),
                    system.D + np.diag(static[list(own)]) @ system.static_gain(),
                    system.bias,
                )
            )
        return changed


def parameters(around: Surroundings) -> tuple[Parameter, ...]:
    """Frequencies up to the sampling's half, and as far down as the record shows ten periods.

    A model discrepancy is mostly slow and resembles a slow mode. Where it is known, the search begins at faster modes.

    deflection: share of the mode's static deflection that is there; without it a mode shows near its frequency alone. Any other static
    part would be a gain.
    """
    nyquist = 0.5 / around.sample_time
    lower, upper = min(10.0 / around.duration, 0.05 * nyquist), 0.95 * nyquist
    begin = lower
    if around.beside_error:
        lower = min(max(3.0 / around.duration, 5.0), 0.05 * nyquist)
        begin = max(min(200.0, 0.2 * nyquist), lower)
    count = 1 + int(np.ceil(np.log(0.8 * nyquist / begin) / np.log(STEP)))
    starts = tuple(np.geomspace(begin, 0.8 * nyquist, count))
    return (
        Parameter("frequency", "Hz", starts[count // 2], starts, lower, upper, 1.0, True),
        Parameter("damping", "", 0.02, (0.03,), 0.002, 0.2, 1.0, True),
        Parameter("gain", "", 0.0, (0.01,), -1.0, 1.0, 0.1, is_size=True),
        Parameter("quadrature", "", 0.0, (0.0,), -1.0, 1.0, 0.03, told=False),
        Parameter("deflection", "", 1.0, (0.7,), 0.0, 1.0, 0.5, told=False),
    )


def coupled_parameters(around: Surroundings) -> tuple[Parameter, ...]:
    """From every input to every sensor a share of the stroke over the command's span, in phase with the mode and in quadrature."""
    frequency, damping, *_ = parameters(around)
    return (
        frequency,
        damping,
        *(
            Parameter(name, "", 0.0, (0.0,), -1.0, 1.0, 0.1, told=False, sensor=sensor, response=f"{part}_{source}")
            for part in PARTS
            for sensor, row in enumerate(names(part, around.axes))
            for source, name in enumerate(row)
        ),
    )


PARTS = tuple(name for name, parameter in declared(CoupledResonance).items() if parameter.dimensions == (2,))
"""Matrices of a mode of all axes: in phase with its position, and in quadrature."""


def names(part: str, axes: int) -> list[list[str]]:
    """Names of the entries [output][input] of one part on `axes` axes."""
    return [[f"{part}_{output}_{source}" for source in range(axes)] for output in range(axes)]


def stage(values: Values, around: Surroundings) -> Stage:
    """The mode of an axis, or of all together."""
    if f"{PARTS[0]}_0_0" not in values:
        static = frozen(np.multiply(values["gain"], np.subtract(values.get("deflection", 1.0), 1.0)))
        return Resonance(values["frequency"], values["damping"], values["gain"], values.get("quadrature", 0.0), static)
    size = around.stroke / max(around.command[1] - around.command[0], 1e-300)
    matrices = [[[size * values[name] for name in row] for row in names(part, around.axes)] for part in PARTS]
    return CoupledResonance(values["frequency"], values["damping"], *matrices)


def gain(values: Values) -> dict[str, float]:
    """Gain of a mode of all axes: its greatest, of motions of one size that differ in their pattern over the inputs."""
    axes = round(np.sqrt(sum(name.startswith(PARTS[0]) for name in values)))
    if not axes:
        return {}
    in_phase, quadrature = (np.array([[values[name] for name in row] for row in names(part, axes)]) for part in PARTS)
    return {"gain": float(np.linalg.norm(in_phase + 1j * quadrature, 2))}


EFFECT = Effect(
    "resonance",
    "mechanics",
    "The mechanics have a further mode.",
    parameters,
    stage,
    coupled_parameters=coupled_parameters,
    static_elsewhere=True,
    summary=gain,
    phrase="a resonance at {frequency}",
)
