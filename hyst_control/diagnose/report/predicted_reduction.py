# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Predicted gap reduction on a command that has not been played yet.

The fitted model, effects and coefficients together, takes the place of the measurement; the gaps of the nominal and of the augmented
model are computed against it. What the model leaves on baseline records, or the best explanation leaves, stays in both gaps. So does
a line, such as the mains: the next session has a phase of its own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.diagnose.problem.problem import Problem
from hyst_control.diagnose.run.diagnosis import AxisDiagnosis, Diagnosis
from hyst_control.diagnose.run.prepare import stated_noise


@dataclass(frozen=True)
class Foreseen:
    """Gap of the nominal and of the augmented model: rms over all axes, without the noise, measurement unit."""

    rms_before: float
    rms_after: float

    @property
    def shrink(self) -> float:
        """1 - (after / before)²; 0 where no gap is predicted."""
        return float(np.clip(1.0 - (self.rms_after / self.rms_before) ** 2, -10.0, 1.0)) if self.rms_before > 0 else 0.0

    def document(self) -> dict[str, float]:
        """Make its part of a gap report."""
        return {"rms_before": self.rms_before, "rms_after": self.rms_after, "shrink": self.shrink}


def foresee(diagnosis: Diagnosis, command: Annotated[Array, "N A"]) -> Foreseen:
    """Predict the gap on a command that has not been played yet."""
    count = len(diagnosis.model.axes)
    if command.ndim != 2 or command.shape[1] != count or len(command) < 2 or not np.isfinite(command).all():
        raise InputError(f"command: must be finite rows of {count} axes, got shape {command.shape}")
    rows = {part.axes: np.ascontiguousarray(command[:, list(part.axes)]) for part in diagnosis.parts}
    fitted = {part.axes: _simulated(part, part.problem.on(rows[part.axes], None), part.coefficients) for part in diagnosis.parts}
    whole = np.hstack([fitted[part.axes] for part in diagnosis.parts])
    before = after = 0.0
    for part in diagnosis.parts:
        problem, z = part.problem.on(rows[part.axes], np.delete(whole, part.axes, axis=1)), part.coefficients
        true = _simulated(part, problem, z, True)
        nominal, augmented = (_simulated(part, problem, 0.0 * z, effects) for effects in (False, True))
        lines = _line_energy(part)
        own = own_error_energy(part, rows[part.axes])
        before += float(np.sum(np.mean((true - nominal) ** 2, axis=0))) + lines + own
        after += float(np.sum(np.mean((true - augmented) ** 2, axis=0))) + lines + own
    return Foreseen(float(np.sqrt(before / count)), float(np.sqrt(after / count)))


def own_error_energy(part: AxisDiagnosis, command: Annotated[Array, "N A"]) -> float:
    """Compute the energy that the model discrepancy adds to every gap on a command."""
    problem = part.problem
    left = problem.rows(part.chosen.solution.residual)
    remainder = float(np.sum(np.maximum(np.mean(left**2, axis=0) - problem.sigma**2, 0.0)))
    if part.baseline is None:
        stated = stated_noise(problem.model)
        return max(remainder, float(np.sum(np.maximum(stated**2 - problem.sigma**2, 0.0))))
    return max(remainder, part.baseline.error_energy(command, problem.sample_time))


def _simulated(part: AxisDiagnosis, problem: Problem, z: Array, effects: bool = False) -> Array:
    """Rows (N, A) of the measurement for coefficients z, with the chosen effects or without."""
    candidate = part.chosen.candidate
    stages = part.linearized.scatter.at(z)
    if candidate is None or not effects:
        return problem.rows(problem.simulate(stages))
    x = part.chosen.solution.x
    flat = problem.simulate(candidate.unknowns().stages(stages, x))
    for member, where in zip(candidate.members, candidate.slices(), strict=True):
        if member.is_extra and not member.is_line:
            flat = flat + replace(member, problem=problem).extra(x[where])
    return problem.rows(flat)


def _line_energy(part: AxisDiagnosis) -> float:
    """Mean square of the lines that were found, with their harmonics, summed over the axes."""
    candidate, x = part.chosen.candidate, part.chosen.solution.x
    if candidate is None:
        return 0.0
    lines = [member.extra(x[where]) for member, where in zip(candidate.members, candidate.slices(), strict=True) if member.is_line]
    return float(np.sum(np.mean(part.problem.rows(np.sum(lines, axis=0)) ** 2, axis=0))) if lines else 0.0
