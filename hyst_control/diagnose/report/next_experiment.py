# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Choice of the next experiment: the excitation that best separates the explanations that are still possible."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.diagnose.configuration import CONFIGURATION, ExperimentSettings
from hyst_control.diagnose.run.diagnosis import AxisDiagnosis, Diagnosis
from hyst_control.diagnose.search.beam_search import FittedHypothesis
from hyst_control.diagnose.search.fit import Linearized
from hyst_control.diagnose.verdict import Verdict
from hyst_control.effects import EFFECTS
from hyst_control.records.excitation.excitation import build

OTHER_SENSOR = "a second, independent displacement sensor"  # Experiment to record where no effect proposes a better one

Excitation = dict[str, Any]  # Configuration of the reference generator


def library(
    lower: float, upper: float, sample_time: float, settings: ExperimentSettings = CONFIGURATION.experiment
) -> dict[str, Excitation]:
    """Excitations to choose from."""
    duration = settings.duration
    span, centre, nyquist = upper - lower, 0.5 * (upper + lower), 0.5 / sample_time
    return {
        "diagnostic record": {"signal": "diagnostic", "lowest": lower, "highest": upper, "duration": 1.5},
        "multisine to a third of Nyquist": {
            "signal": "multisine",
            "period": 0.25,
            "lower_frequency": 4.0,
            "upper_frequency": nyquist / 3,
            "rms": 0.12 * span,
            "offset": centre,
            "periods": 4,
            "lower": lower,
            "upper": upper,
        },
        "slow triangle": {"signal": "triangle", "frequency": 2.0, "amplitude": 0.5 * span, "offset": centre, "duration": duration},
        "steps": {"signal": "steps", "lowest": lower, "highest": upper, "hold": duration / 12, "count": 10},
        "long hold": {"signal": "step", "height": 0.8 * span, "offset": lower, "before": 0.1, "after": 5.0},
        "sweep": {
            "signal": "sweep",
            "start_frequency": 5.0,
            "stop_frequency": nyquist / 4,
            "amplitude": 0.25 * span,
            "offset": centre,
            "duration": duration,
        },
    }


def next_experiment(diagnosis: Diagnosis) -> dict[str, Any] | None:
    """Choose the excitation of largest worst-pair distance between what is still possible."""
    part = next((part for part in diagnosis.parts if part.decision.verdict is Verdict.AMBIGUOUS), None)
    if part is None:
        return None
    settings = diagnosis.configuration.experiment
    rivals = part.listed[: settings.rivals]
    lower, upper = diagnosis.problem.surroundings.command
    best: tuple[float, str, Excitation] | None = None
    for name, excitation in library(lower, upper, diagnosis.problem.sample_time, settings).items():
        try:
            command = build(excitation, diagnosis.problem.sample_time, len(diagnosis.model.axes))
            distance = _distance(part, rivals, command)
        except (InputError, TypeError):
            continue
        if best is None or distance > best[0]:
            best = distance, name, excitation
    if best is None:
        return None
    return {
        "excitation": best[1],
        "separates": ["+".join(scored.names) or "parameters" for scored in rivals],
        "expected_odds": float(np.exp(min(0.5 * best[0] ** 2, 300.0))),
        "distance": float(best[0]),
        "configuration": best[2],
        "note": "" if best[0] >= settings.distance else _channel(rivals),
    }


def _channel(rivals: Sequence[FittedHypothesis]) -> str:
    """The channel that would tell what no excitation can: the first that one of the effects names."""
    named = (EFFECTS[name].separating_record for scored in rivals for name in scored.names)
    return f"no excitation separates them: record {next(filter(None, named), OTHER_SENSOR)} as well"


def _distance(part: AxisDiagnosis, rivals: Sequence[FittedHypothesis], command: Array) -> float:
    """The smallest distance between two rivals' predictions, coefficients marginalized."""
    problem = part.problem
    others = None if problem.pieces[0].others is None else np.zeros((len(command), problem.pieces[0].others.shape[1]))
    fresh = problem.on(np.ascontiguousarray(command[:, list(part.axes)]), others)
    linearized = Linearized(fresh, replace(part.linearized.scatter))
    predictions = []
    for scored in rivals:
        if scored.candidate is None:
            predictions.append(linearized.nominal)
            continue
        members = type(scored.candidate)(tuple(replace(member, problem=fresh) for member in scored.candidate.members))
        predictions.append(linearized.simulate(np.zeros(linearized.count), members.unknowns(), scored.solution.x))
    if not all(np.isfinite(rows).all() for rows in (*predictions, linearized.columns)):
        raise InputError("a prediction leaves the finite under this excitation: it separates nothing")
    distances = []
    for i, one in enumerate(predictions):
        for other in predictions[i + 1 :]:
            apart = one - other
            distances.append(np.sqrt(max(fresh.weight * float(apart @ linearized.unexplained(apart)), 0.0)))
    return float(min(distances, default=0.0))
