# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""From the evidence of a search to a decision: what candidates leave is measured on demand."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from hyst_control.base.arrays import Array
from hyst_control.base.parallel import map_known
from hyst_control.diagnose.configuration import Configuration, Thresholds
from hyst_control.diagnose.decide.policy import contenders, decide
from hyst_control.diagnose.evidence import Evidence, Finding, ResidualEvidence
from hyst_control.diagnose.model_error.baseline import Baseline
from hyst_control.diagnose.run.collect import companions, residual_evidence
from hyst_control.diagnose.run.prepare import Prepared
from hyst_control.diagnose.search.beam_search import FittedHypothesis, Found
from hyst_control.diagnose.search.fit import Linearized
from hyst_control.diagnose.verdict import Decision
from hyst_control.effects.effect import RecordCheck


class Tests(Protocol):
    """Tests of a candidate, by its index among the hypotheses."""

    def residuals(self, indices: Sequence[int]) -> dict[int, ResidualEvidence]:
        """Measure what some of them leave."""


def settled(evidence: Evidence, tests: Tests, thresholds: Thresholds) -> tuple[Evidence, Decision]:
    """Decide, with what every candidate leaves."""
    missing = [index for index in contenders(evidence, thresholds) if evidence.hypotheses[index].residual is None]
    evidence = evidence.with_residuals(tests.residuals(missing))
    return evidence, decide(evidence, thresholds)


class ContenderTests:
    """Tests of an axis' candidates on its records; each is done once."""

    def __init__(self, prepared: Prepared, found: Found, baseline: Baseline | None, configuration: Configuration) -> None:
        """Keep what tests need, and do none."""
        self._prepared, self._found = prepared, found
        self._usual = baseline and baseline.usual_zero
        self._configuration = configuration
        self._residuals: dict[int, ResidualEvidence] = {}

    def residuals(self, indices: Sequence[int]) -> dict[int, ResidualEvidence]:
        """Measure what hypotheses leave."""
        prepared = self._prepared
        new = [index for index in indices if index not in self._residuals]
        same = (prepared.findings, prepared.checks, self._configuration, self._found.temper, self._usual)
        measured = map_known(_residual, [(prepared.linearized, self._found.hypotheses[index], *same) for index in new])
        self._residuals.update(zip(new, measured, strict=True))
        return {index: self._residuals[index] for index in indices}


def _residual(
    linearized: Linearized,
    scored: FittedHypothesis,
    findings: Sequence[Finding],
    checks: frozenset[RecordCheck],
    configuration: Configuration,
    temper: float,
    usual: Array | None,
) -> ResidualEvidence:
    """Measure the residual of a hypothesis, beside the usual zero of a session (A, 3)."""
    zero = () if usual is None else companions(linearized, scored, usual, temper)
    return residual_evidence(linearized.problem, scored, findings, checks, configuration, zero)
