"""The augmented model: the nominal one with the effects added at their places, ready for the plant node and the feedforward."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from hyst_control.base.errors import InputError
from hyst_control.chain.stage import Stage
from hyst_control.diagnose.record_checks.summary import effect_found_by
from hyst_control.diagnose.run.collect import stated_noise
from hyst_control.diagnose.run.diagnosis import Diagnosis
from hyst_control.diagnose.search.candidate import Member
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
            found = member.values(solution.x[where]) | _phase(member, solution.x[where])
            for name, value in found.items():
                slots = values.setdefault((member.name, nth), {}).setdefault(name, [_absent(diagnosis, member.name, name)] * count)
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
    """Take the lines out of an augmented model, such as the mains or a vibration, to compare it with a record of another session.

    Their phases are those of the record that was diagnosed; a session has phases of its own.
    """
    lines = {name for name, effect in EFFECTS.items() if effect.line is not None}
    return model.with_stages([stage for stage in model.chain.stages if stage.name not in lines])


def _stage(diagnosis: Diagnosis, name: str, values: Mapping[str, list[float]]) -> Stage:
    simple: dict[str, Any] = {key: slots[0] if len(set(slots)) == 1 else slots for key, slots in values.items()}
    try:
        return EFFECTS[name].stage(simple, diagnosis.problem.surroundings)
    except (InputError, TypeError, ValueError) as error:
        raise InputError(f"{name}: cannot be added to this model ({error})") from None


def _absent(diagnosis: Diagnosis, effect: str, parameter: str) -> float:
    """The value on an axis that the effect is not on."""
    known = {p.name: p.absent for p in EFFECTS[effect].parameters(diagnosis.problem.surroundings)}
    return known.get(parameter, 0.0)  # a line's phase, an entry of a matrix


def _phase(member: Member, x: np.ndarray) -> dict[str, float]:
    """Of a line, from its sine and cosine."""
    return {"phase": float(np.arctan2(x[member.line.swells], x[0]))} if member.is_line else {}


def _noise(diagnosis: Diagnosis) -> list[float] | float | None:
    """The noise with what was found beside what the model states."""
    stated = stated_noise(diagnosis.model)
    more = False
    for part in diagnosis.parts:
        for finding in part.decision.findings:
            if finding.check.is_noise:
                axis = part.axes[finding.axis]
                stated[axis], more = float(np.hypot(stated[axis], finding.rms)), True
    if not more:
        return None
    return float(stated[0]) if len(set(stated)) == 1 else [float(value) for value in stated]
