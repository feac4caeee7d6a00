# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Hypotheses that a decision did not name, each with its evidence and the reason that counted against it, for the report's page."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hyst_control.diagnose.configuration import Thresholds
from hyst_control.diagnose.decide.policy import strained
from hyst_control.diagnose.evidence import Evidence, HypothesisEvidence
from hyst_control.diagnose.run.diagnosis import AxisDiagnosis, Diagnosis
from hyst_control.effects import EFFECTS


@dataclass(frozen=True)
class Rejected:
    """Hypothesis that was weighed and not named."""

    name: str  # Effects joined by "and", or "coefficients alone"
    axes: str  # Names of the axes of its problem
    behind: float  # Evidence that it lacks to the best explanation, nats
    left: float  # Share of the gap's energy that it leaves, noise included
    why: str  # Reason that counted against it, one line


def rejected(diagnosis: Diagnosis, most: int) -> list[Rejected]:
    """List the rivals of the best explanation, the closest first."""
    rows = [row for part in diagnosis.parts for row in _of_axis(diagnosis, part)]
    return sorted(rows, key=lambda row: row.behind)[:most]


def _of_axis(diagnosis: Diagnosis, part: AxisDiagnosis) -> list[Rejected]:
    evidence, thresholds = part.evidence, diagnosis.configuration.policy
    best = evidence.hypotheses[part.decision.chosen]
    named = {tuple(sorted(evidence.hypotheses[index].names)) for index in (*part.decision.listed, part.decision.chosen)}
    closest: dict[tuple[str, ...], int] = {}
    for index, one in enumerate(evidence.hypotheses[1:], 1):
        names = tuple(sorted(one.names))
        if names in named and (names or part.decision.chosen and best.coefficients_alone):
            continue
        if names not in closest or one.score > evidence.hypotheses[closest[names]].score:
            closest[names] = index
    axes = ", ".join(diagnosis.model.axes[axis] for axis in part.axes)

    def energy(index: int) -> float:
        # In units of the measurement, as every other share of the report, however the fits weigh it.
        return float(np.sum(part.problem.in_noise(part.hypotheses[index].solution.residual) ** 2))

    whole = max(energy(0), 1e-300)
    return [
        Rejected(
            " and ".join(name.replace("_", " ") for name in one.names) or "coefficients alone",
            axes,
            best.score - one.score,
            energy(index) / whole,
            _reason(one, best, evidence, thresholds),
        )
        for index in closest.values()
        for one in (evidence.hypotheses[index],)
    ]


def _reason(one: HypothesisEvidence, best: HypothesisEvidence, evidence: Evidence, thresholds: Thresholds) -> str:
    """The first rule of the policy that it fails, or what the best explanation does better."""
    gain = evidence.temper * (evidence.hypotheses[0].misfit - one.misfit)
    if one.names and gain <= evidence.null + thresholds.margin:
        return "explains no more than effects do by chance on simulated records without a gap"
    if one.coefficients_alone and one.score <= thresholds.margin:
        return "coefficients would have to leave their tolerance too far for what they explain"
    if set(best.names) < set(one.names):
        return "adds too little to the best explanation"
    if strained(one.strain, evidence.coefficients, thresholds) and not strained(best.strain, evidence.coefficients, thresholds):
        return "needs coefficients beyond their tolerance, which the best explanation does not"
    if one.energy > 1.05 * best.energy:
        return "leaves more of the gap than the best explanation"
    if len(one.names) > len(best.names):
        return "needs more effects than the best explanation to leave as little"
    if one.score >= best.score:
        return "explains the numbers as well, but is not a claim of its own"
    place = {EFFECTS[name].place for name in one.names if name in EFFECTS}
    where = f" (at the {', '.join(sorted(place))})" if place else ""
    return f"fits nearly as well{where}, with less evidence"
