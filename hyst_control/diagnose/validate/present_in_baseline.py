# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Effects that baseline records show as well: parts that the model never had, and nothing that has changed.

An effect that brings the simulation closer to baseline records of other commands too, with the very parameters that the new record asks
for, was there before. The coefficients are free within their uncertainty on both sides.
"""

from __future__ import annotations

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.diagnose.problem.coefficient_prior import scatter_of
from hyst_control.diagnose.problem.problem import Problem
from hyst_control.diagnose.search.beam_search import FittedHypothesis
from hyst_control.diagnose.search.candidate import Candidate
from hyst_control.diagnose.search.fit import Linearized, is_bounded
from hyst_control.records.session_zero import without_zero


class CleanRecords:
    """Baseline records of other commands, with what the coefficients of the nominal model can move on them."""

    def __init__(self, problem: Problem) -> None:
        """Simulate the coefficients' columns; problem: with the noise and the spectrum of the model discrepancy."""
        self.problem = problem
        self.linearized = Linearized(problem, scatter_of(problem.model))
        columns = np.empty_like(self.linearized.columns)
        for k, column in enumerate(self.linearized.columns.T):
            columns[:, k] = self._without_zero(column)
        self.columns, self.gram = columns, columns.T @ columns + np.eye(columns.shape[1])
        self.nominal = self._misfit(self.linearized.nominal)

    @property
    def independent(self) -> float:
        """Independent values of the model discrepancy, as a share of its bins.

        What the coefficients explain of the baseline records, beside what they would explain of as much noise by chance: the expectation of
        ½ rᵀJ (JᵀJ + 1)⁻¹ Jᵀr is ½ tr(JᵀJ (JᵀJ + 1)⁻¹) where all values of r are independent.
        """
        residual = self._without_zero(self.linearized.measured - self.linearized.nominal)
        explained = 0.5 * float(residual @ residual) - self.nominal
        by_chance = 0.5 * (len(self.gram) - float(np.trace(np.linalg.inv(self.gram))))
        return min(by_chance / explained, 1.0) if explained > 0.0 else 1.0

    def show(self, scored: FittedHypothesis, least: float) -> frozenset[str]:
        """Find the effects of an explanation that the baseline records ask for, too."""
        assert scored.candidate is not None, "no effect"
        stages, found = self.problem.model.chain.stages, set()
        for member, part in zip(scored.candidate.members, scored.candidate.slices(), strict=True):
            if member.is_extra:
                continue
            try:
                simulated = self.problem.simulate(Candidate((member,)).unknowns().stages(stages, scored.solution.x[part]))
            except InputError:
                continue  # no baseline record would have come out of it
            if self.nominal - self._misfit(simulated) > least:
                found.add(member.name)
        return frozenset(found)

    def _misfit(self, simulated: Array) -> float:
        """Half the squares that the coefficients leave of a residual (M,); infinite where a chain ran away."""
        residual = self.linearized.measured - simulated
        if not is_bounded(residual):
            return np.inf
        residual = self._without_zero(residual)
        right = self.columns.T @ residual
        return 0.5 * float(residual @ residual - right @ np.linalg.solve(self.gram, right))

    def _without_zero(self, flat: Array) -> Array:
        """A vector (M,) without the zero and the drift of each record."""
        return np.concatenate([without_zero(rows)[0].reshape(-1) for rows in self.problem.by_piece(flat)])
