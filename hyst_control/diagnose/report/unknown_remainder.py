# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Remainder of a gap that no known effect explains: how much of it follows the command, where, and the stage that adds this part."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.chain.command_features import FEATURES
from hyst_control.diagnose.problem.problem import axis_model
from hyst_control.diagnose.run.diagnosis import AxisDiagnosis, Diagnosis
from hyst_control.diagnose.validate.predictability import Predictability, learn_residual, predictability
from hyst_control.diagnose.verdict import Verdict
from hyst_control.effects import insert
from hyst_control.effects.learned_residual import LearnedResidual
from hyst_control.model_file import Model
from hyst_control.records.session_zero import without_zero


@dataclass(frozen=True)
class Remainder:
    """Remainder of the axes whose gap no known effect explains."""

    predictable: Predictability  # Of the axis on which most is left
    # By the index of an axis: what adds the predictable part to its model; none of axes that the model mixes, or where it takes nothing off
    stages: Mapping[int, LearnedResidual]
    # Of the gap beside the effects that are named, with these stages, on blocks not used for the fit; None without a stage
    shrink: float | None

    def document(self, added: bool) -> dict[str, Any]:
        """Make its part of a gap report."""
        parts = {name: [asdict(row) for row in getattr(self.predictable, name)] for name in ("band", "level", "branch")}
        learned = None if self.shrink is None else {"shrink": self.shrink, "added": added}
        return {"share": self.predictable.share, **parts, "learned": learned}


def remainder_of(diagnosis: Diagnosis) -> Remainder | None:
    """Measure what is left where no known effect explains the gap."""
    unknown = [part for part in diagnosis.parts if part.decision.verdict is Verdict.UNKNOWN]
    if not unknown:
        return None
    worst = max(unknown, key=lambda part: part.decision.remainder)
    settings = diagnosis.configuration
    left = worst.problem.rows(worst.chosen.solution.residual)
    found = predictability(worst.problem, left, settings.budget.bands, settings.baseline.blocks)
    stages, shrinks = {}, {}
    for part in unknown:
        if len(part.axes) == 1:
            stage, shrink = learn_residual(part.problem, _as_given(diagnosis, part), settings.baseline.blocks)
            shrinks[part.axes[0]] = shrink
            if shrink > 0.0:  # one that rows held out do not confirm makes the model worse
                stages[part.axes[0]] = stage
    return Remainder(found, stages, shrinks.get(worst.axes[0]))


def with_learned_residual(model: Model, remainder: Remainder) -> Model:
    """Add what follows the command to a model."""
    first = next(iter(remainder.stages.values()))
    absent = replace(first, weights=(0.0,) * FEATURES, constant=0.0)
    axes = [remainder.stages.get(axis, absent) for axis in range(len(model.axes))]
    values = {name: [getattr(stage, name) for stage in axes] for name in first.parameters()}
    stage = first if len(axes) == 1 else LearnedResidual(**{"constant": [0.0] * len(axes), **values})
    return model.with_stages(insert(model.chain.stages, stage.place, stage))


def _as_given(diagnosis: Diagnosis, part: AxisDiagnosis) -> Array:
    """Residual (M, 1) of one axis with the effects of the best explanation and the coefficients as given."""
    model = diagnosis.model if len(diagnosis.model.axes) == 1 else axis_model(diagnosis.model, part.axes[0])
    stages, x = model.chain.stages, part.chosen.solution.x
    unknowns = part.chosen.candidate.unknowns() if part.chosen.candidate else None
    simulated = part.problem.simulate(unknowns.stages(stages, x) if unknowns else stages)
    if unknowns and unknowns.extra is not None:
        simulated = simulated + unknowns.extra(x)
    rows = part.problem.rows(part.problem.measured() - simulated)
    if part.baseline is None:
        return rows
    return np.concatenate([without_zero(one)[0] for one in np.split(rows, part.problem.edges)])
