# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Coefficients of the nominal model before and after the fit of the best explanation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.chain.stage import Stage
from hyst_control.diagnose.problem.coefficient_prior import Coefficient, Scatter
from hyst_control.diagnose.run.diagnosis import Diagnosis


@dataclass(frozen=True)
class CoefficientChange:
    """One coefficient."""

    name: str  # As in the gap report, with its axis where there are several problems
    # before, after: Value in the model file, and as fitted with the best explanation; in the model file's unit
    before: float
    after: float
    deviations: float  # Distance in standard deviations of its tolerance


def coefficient_changes(diagnosis: Diagnosis, most: int) -> list[CoefficientChange]:
    """List coefficients with their values before and after, those that moved most first."""
    found = []
    for part in diagnosis.parts:
        axis = f" ({diagnosis.model.axes[part.axes[0]]})" if len(diagnosis.parts) > 1 else ""
        scatter, z = part.linearized.scatter, part.coefficients
        fitted = scatter.at(z)
        for index, coefficient in enumerate(scatter.coefficients):
            if not coefficient.companion:
                before, after = _values(scatter, coefficient, index, z, fitted)
                found.append(CoefficientChange(coefficient.name + axis, before, after, float(z[index])))
    return sorted(found, key=lambda change: -abs(change.deviations))[:most]


def _values(scatter: Scatter, coefficient: Coefficient, index: int, z: Array, fitted: tuple[Stage, ...]) -> tuple[float, float]:
    """Value before and after: of the number itself, or of the number by which a column of the uncertainty's factor is called."""
    if coefficient.path:
        return tuple(  # type: ignore[return-value]
            float(np.array(getattr(_stage(stages, coefficient.path), coefficient.field))[coefficient.index])
            for stages in (scatter.model.chain.stages, fitted)
        )
    assert scatter.joint is not None
    joint, columns = scatter.joint, scatter.joint.factor.shape[1]
    row = next(i for i, name in enumerate(joint.names) if name.partition(".")[2] == coefficient.name)
    sizes = np.array([one.tolerance for one in scatter.coefficients[:columns]])
    return float(joint.values[row]), float((joint.values + joint.factor @ (sizes * z[:columns]))[row])


def _stage(stages: tuple[Stage, ...], path: tuple[int, ...]) -> Stage:
    stage = stages[path[0]]
    return stage if len(path) == 1 else _stage(tuple(stage.inner_chains[path[1]]), path[2:])
