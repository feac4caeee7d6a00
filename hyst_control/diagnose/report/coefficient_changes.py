# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Coefficients of the nominal model before and after the fit of the best explanation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.chain.coordinates import chain_coordinates
from hyst_control.diagnose.problem.coefficient_prior import Coefficient, Scatter, stage_at
from hyst_control.diagnose.problem.problem import Problem
from hyst_control.diagnose.run.diagnosis import AxisDiagnosis, Diagnosis
from hyst_control.records.correlation import matching_length

LIKELY = 1.645  # Standard deviations on either side that hold 90 %


@dataclass(frozen=True)
class CoefficientChange:
    """One coefficient."""

    name: str  # As in the gap report, with its axis where there are several problems
    # before, after: Value in the model file, and as fitted with the best explanation; in the model file's unit
    before: float
    after: float
    deviations: float  # Distance in standard deviations of its tolerance
    spread: float  # Half of the 90 % interval of `after`
    unit: str  # "" where it is none or depends on those of the signals


def coefficient_changes(diagnosis: Diagnosis, most: int | None = None) -> list[CoefficientChange]:
    """List coefficients with their values before and after, those that moved most first."""
    found = []
    for part in diagnosis.parts:
        axis = f" ({diagnosis.model.axes[part.axes[0]]})" if len(diagnosis.parts) > 1 else ""
        scatter, z = part.linearized.scatter, part.coefficients
        deviations = LIKELY * np.sqrt(repetition(part.problem)) * _factor(part)
        for index, coefficient in enumerate(scatter.coefficients):
            if not coefficient.companion:
                before, slope, unit = _of(scatter, coefficient, index)
                found.append(
                    CoefficientChange(
                        coefficient.name + axis,
                        before,
                        before + float(slope @ z),
                        float(z[index]),
                        float(np.linalg.norm(slope @ deviations)),
                        unit,
                    )
                )
    return sorted(found, key=lambda change: -abs(change.deviations))[:most]


def _factor(part: AxisDiagnosis) -> Array:
    """Factor (K, K) of the covariance of the coefficients, in tolerances."""
    count = part.linearized.count
    covariance = part.chosen.solution.covariance[:count, :count] / part.found.temper
    values, vectors = np.linalg.eigh(covariance)
    tolerances = np.broadcast_to(part.chosen.tolerances, count)
    return np.asarray(tolerances[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)), dtype=np.float64)


def _of(scatter: Scatter, coefficient: Coefficient, index: int) -> tuple[float, Array, str]:
    """Value before, its slope by every z (K,), and unit: of the number itself, or of that by which a column of the factor is called."""
    stages, slope = scatter.model.chain.stages, np.zeros(len(scatter.coefficients))
    if coefficient.path:
        stage = stage_at(stages, coefficient.path)
        before = float(np.array(getattr(stage, coefficient.field))[coefficient.index])
        slope[index] = before * coefficient.tolerance
        return before, slope, ""
    assert scatter.joint is not None
    joint, columns = scatter.joint, scatter.joint.factor.shape[1]
    row = next(i for i, name in enumerate(joint.names) if name.partition(".")[2] == coefficient.name)
    slope[:columns] = joint.factor[row] * np.array([one.tolerance for one in scatter.coefficients[:columns]])
    unit = chain_coordinates(stages, scatter.model.axes)[joint.names[row]].unit
    return float(joint.values[row]), slope, "" if "unit" in unit else unit


def repetition(problem: Problem) -> float:
    """Factor by which a record says less of an effect where the model discrepancy has a size and a correlation alone."""
    if problem.own_spectrum is not None or not problem.weighs_own_error:
        return 1.0
    length = max(matching_length(piece.counted(piece.command)) for piece in problem.pieces)
    return max(length / problem.own_correlation, 1.0)
