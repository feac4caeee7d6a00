# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Every hypothesis that a record could speak for: the effects of the catalogue in all their realizations, on every axis."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from hyst_control.diagnose.problem.problem import Problem
from hyst_control.diagnose.record_checks.spectral_lines import takes_up_command
from hyst_control.diagnose.search.candidate import Member
from hyst_control.effects import EFFECTS
from hyst_control.effects.effect import Parameter


def catalogue(
    problem: Problem,
    suggested: Mapping[str, Sequence[float]],
    without: Sequence[str] = (),
    holds: Sequence[tuple[int, int]] = (),
) -> list[Member]:
    """Every realization of every effect that the record could show, on all axes of the problem alike and on every single one."""
    # suggested: by the name of an effect: frequencies (Hz) of lines in the residual's spectrum, or starts of its suggested
    # parameter; holds: of the command, as `Surroundings` has them
    count = len(problem.model.axes)
    others = 0 if problem.pieces[0].others is None else problem.pieces[0].others.shape[1]
    surroundings = replace(problem.surroundings, axes=count + others, holds=tuple(holds))
    axes: list[int | None] = [None] if count == 1 else [None, *range(count)]
    commands = [piece.command for piece in problem.pieces]
    found: list[Member] = []
    for name, effect in EFFECTS.items():
        if name in without or (not effect.waveform and effect.line is None) or not effect.exercised(surroundings):
            continue
        if effect.couples and count + others < 2:
            continue
        parameters = effect.parameters(surroundings)
        if effect.line is not None:
            for frequency in suggested.get(name, ()):
                shapes = [
                    shape for shape in (effect.line, *effect.further_lines) if not takes_up_command(problem, frequency, shape)
                ]
                found += [
                    Member(effect, parameters, problem, axis, frequency, shape=shape) for axis in axes[-count:] for shape in shapes
                ]
            continue
        parameters = tuple(_suggested(parameter, suggested.get(name, ())) for parameter in parameters)
        together = effect.coupled_parameters(problem.surroundings) if count > 1 and effect.coupled_parameters else parameters
        for axis in [None] if effect.shared else axes:
            own = together if axis is None else parameters
            for fixed in effect.variants(surroundings):
                fitted = tuple(parameter for parameter in own if parameter.name not in fixed)
                if any(parameter.suggested for parameter in fitted) and not suggested.get(name):
                    continue  # nothing of the kind in this record
                if not effect.distinct(fixed, commands):
                    continue
                found.append(Member(effect, fitted, problem, axis, fixed=tuple(fixed.items())))
        if effect.separate_sizes and count > 1:
            found.append(Member(effect, count * parameters, problem, separate_sizes=True))
    return found + [
        replace(member, elsewhere=place)
        for member in found
        for place in member.effect.also_at + (member.effect.also_beside_clean if problem.beside_error else ())
    ]


def _suggested(parameter: Parameter, starts: Sequence[float]) -> Parameter:
    """A parameter with the starts that a check of the record suggests, where it takes any."""
    inside = tuple(start for start in starts if parameter.lower <= start <= parameter.upper)
    return replace(parameter, starts=inside) if parameter.suggested and inside else parameter
