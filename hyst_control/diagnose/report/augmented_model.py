# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The augmented model: the nominal one with the effects added at their places, ready for the plant node and the feedforward."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from hyst_control.base.errors import InputError
from hyst_control.chain.stage import Stage
from hyst_control.diagnose.record_checks.summary import effect_found_by
from hyst_control.diagnose.run.diagnosis import Diagnosis
from hyst_control.diagnose.run.prepare import stated_noise
from hyst_control.effects import EFFECTS, insert
from hyst_control.model_file import Model


def augmented(diagnosis: Diagnosis) -> Model | None:
    """Insert the best explanation of every axis into the nominal model."""
    count = len(diagnosis.model.axes)
    values: dict[tuple[str, int], dict[str, list[float]]] = {}
    places: dict[tuple[str, int], str] = {}
    for part in diagnosis.parts:
        candidate, solution = part.chosen.candidate, part.chosen.solution
        if candidate is None:
            continue
        met: dict[str, int] = {}
        for member, where in zip(candidate.members, candidate.slices(), strict=True):
            axes = part.axes if member.axis is None else (part.axes[member.axis],)
            nth = met.get(member.name, 0)
            met[member.name] = nth + 1
            places[member.name, nth] = member.place
            x = solution.x[where]
            found = member.values(x)
            if member.is_line:
                found["phase"] = float(np.arctan2(x[member.line.swells], x[0]))  # of its sine and cosine
            absent = {p.name: p.absent for p in member.effect.parameters(diagnosis.problem.surroundings)}
            for name, value in found.items():
                # A line's phase, or an entry of a matrix, is 0 on an axis that the effect is not on.
                slots = values.setdefault((member.name, nth), {}).setdefault(name, [absent.get(name, 0.0)] * count)
                for axis in axes:
                    slots[axis] = value
    for part in diagnosis.parts:
        for finding in part.decision.findings:
            effect = effect_found_by(finding.check)
            if effect is None or finding.check.is_noise or finding.check.is_of_the_record:
                continue
            parameter = effect.checked_parameter(diagnosis.problem.surroundings)
            slots = values.setdefault((effect.name, 0), {}).setdefault(parameter.name, [parameter.absent] * count)
            slots[part.axes[finding.axis]] = finding.value
    noise = _noise(diagnosis)
    if not values and noise is None:
        return None
    stages = diagnosis.model.chain.stages
    order = list(EFFECTS)
    for name, nth in sorted(values, key=lambda key: order.index(key[0])):
        stages = insert(stages, places.get((name, nth), EFFECTS[name].place), _stage(diagnosis, name, values[name, nth]))
    model = diagnosis.model.with_stages(stages)
    model = replace(model, name=f"{model.name}_augmented")
    return model if noise is None else replace(model, noise={**model.noise, "sigma": noise})


def without_lines(model: Model) -> Model:
    """Take the lines out of an augmented model, such as the mains or a vibration, to compare it with a record of another session."""
    lines = {name for name, effect in EFFECTS.items() if effect.line is not None}
    return model.with_stages([stage for stage in model.chain.stages if stage.name not in lines])


def _stage(diagnosis: Diagnosis, name: str, values: Mapping[str, list[float]]) -> Stage:
    simple: dict[str, Any] = {key: slots[0] if len(set(slots)) == 1 else slots for key, slots in values.items()}
    try:
        return EFFECTS[name].stage(simple, diagnosis.problem.surroundings)
    except (InputError, TypeError, ValueError) as error:
        raise InputError(f"{name}: cannot be added to this model ({error})") from None


def _noise(diagnosis: Diagnosis) -> list[float] | float | None:
    """The noise with what was found beside what the model states."""
    stated = stated_noise(diagnosis.model)
    more = [(part.axes[one.axis], one.rms) for part in diagnosis.parts for one in part.decision.findings if one.check.is_noise]
    if not more:
        return None
    for axis, rms in more:
        stated[axis] = float(np.hypot(stated[axis], rms))
    return float(stated[0]) if len(set(stated)) == 1 else [float(value) for value in stated]
