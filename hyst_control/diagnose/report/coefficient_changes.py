# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Coefficients of the nominal model before and after the fit of the best explanation."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.chain.coordinates import chain_coordinates
from hyst_control.diagnose.problem.coefficient_prior import Scatter, stage_at
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
    deviations: float  # Distance in standard deviations of what the model file allows
    spread: float  # Half of the 90 % interval of `after`
    unit: str  # "" where it is none or depends on those of the signals

    @property
    def is_certain(self) -> bool:
        """True where the interval of `after` does not hold `before`."""
        return abs(self.after - self.before) > self.spread


def strain(diagnosis: Diagnosis) -> float:
    """Distance of all coefficients together from the model file's, in standard deviations, of the axis that is furthest off."""
    own = (part.coefficients[part.linearized.scatter.companions == 0.0] for part in diagnosis.parts)
    return max(float(np.linalg.norm(each)) for each in own)


def coefficient_changes(diagnosis: Diagnosis) -> list[CoefficientChange]:
    """List coefficients with their values before and after, those that moved most first."""
    found = []
    for part in diagnosis.parts:
        axis = f" ({diagnosis.model.axes[part.axes[0]]})" if len(diagnosis.parts) > 1 else ""
        deviations = LIKELY * np.sqrt(repetition(part.problem)) * _factor(part)
        for name, before, slope, unit in _numbers(part.linearized.scatter):
            moved, allowed = float(slope @ part.coefficients), float(np.linalg.norm(slope))
            spread = float(np.linalg.norm(slope @ deviations))
            found.append(CoefficientChange(name + axis, before, before + moved, moved / allowed, spread, unit))
    return sorted(found, key=lambda change: -abs(change.deviations))


def _factor(part: AxisDiagnosis) -> Array:
    """Factor (K, K) of the covariance of the coefficients, in tolerances."""
    count = part.linearized.count
    covariance = part.chosen.solution.covariance[:count, :count] / part.found.temper
    values, vectors = np.linalg.eigh(covariance)
    tolerances = np.broadcast_to(part.chosen.tolerances, count)
    return np.asarray(tolerances[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)), dtype=np.float64)


def _numbers(scatter: Scatter) -> Iterator[tuple[str, float, Array, str]]:
    """Name, value, slope by every z (K,) and unit of every number that the model file lets scatter."""
    stages, sizes = scatter.model.chain.stages, np.array([one.tolerance for one in scatter.coefficients])
    for index, one in enumerate(scatter.coefficients):
        if one.path and not one.companion:
            value = float(np.array(getattr(stage_at(stages, one.path), one.field))[one.index])
            yield one.name, value, value * sizes * (np.arange(len(sizes)) == index), ""
    if scatter.joint is not None:
        joint, known = scatter.joint, chain_coordinates(stages, scatter.model.axes)
        for name, value, row in zip(joint.names, joint.values.tolist(), joint.factor, strict=True):
            if np.any(row):
                unit = "" if "unit" in known[name].unit or known[name].unit == "gain" else known[name].unit
                yield name.partition(".")[2], value, sizes * np.pad(row, (0, len(sizes) - len(row))), unit


def repetition(problem: Problem) -> float:
    """Factor by which a record says less of an effect where the model discrepancy has a size and a correlation alone."""
    if problem.own_spectrum is not None or not problem.weighs_own_error:
        return 1.0
    length = max(matching_length(piece.counted(piece.command)) for piece in problem.pieces)
    return max(length / problem.own_correlation, 1.0)
