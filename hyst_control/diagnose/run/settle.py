# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""From the evidence of a search to a decision: what candidates leave is measured on demand, and what does not hold is dropped."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

from hyst_control.base.arrays import Array
from hyst_control.base.parallel import map_known
from hyst_control.diagnose.configuration import Configuration, Thresholds
from hyst_control.diagnose.decide.policy import contenders, decide, exceeds
from hyst_control.diagnose.evidence import Evidence, Finding, ResidualEvidence
from hyst_control.diagnose.model_error.baseline import Baseline
from hyst_control.diagnose.run.collect import companions, residual_evidence
from hyst_control.diagnose.run.prepare import Prepared
from hyst_control.diagnose.search.beam_search import FittedHypothesis, Found
from hyst_control.diagnose.search.fit import Linearized
from hyst_control.diagnose.validate.constancy import distortions
from hyst_control.diagnose.validate.cross_validation import holds, left_out, widens
from hyst_control.diagnose.verdict import Decision
from hyst_control.effects.effect import RecordCheck

VETOES = 6  # Explanations in turn that are dropped


class Tests(Protocol):
    """Tests of a candidate, by its index among the hypotheses."""

    def residuals(self, indices: Sequence[int]) -> dict[int, ResidualEvidence]:
        """Measure what some of them leave."""

    def dropped(self, index: int) -> tuple[int, ...]:
        """Hypotheses that are dropped because it does not hold; none where it does."""


def settled(evidence: Evidence, tests: Tests, thresholds: Thresholds) -> tuple[Evidence, Decision]:
    """Decide, with the candidates tested; where the best one does not hold, the next is tested in turn."""
    for _ in range(VETOES if evidence.whitened else 0):
        evidence = _measured(evidence, tests, thresholds)
        decision = decide(evidence, thresholds)
        dropped = tests.dropped(decision.chosen) if evidence.hypotheses[decision.chosen].names else ()
        if not dropped:
            return evidence, decision
        evidence = evidence.without(dropped)
    if evidence.whitened and VETOES:  # what comes after so many that do not hold explains still less
        evidence = evidence.without(range(1, len(evidence.hypotheses)))
    evidence = _measured(evidence, tests, thresholds)
    return evidence, decide(evidence, thresholds)


def _measured(evidence: Evidence, tests: Tests, thresholds: Thresholds) -> Evidence:
    """The evidence with what every candidate leaves."""
    missing = [index for index in contenders(evidence, thresholds) if evidence.hypotheses[index].residual is None]
    return evidence.with_residuals(tests.residuals(missing))


class ContenderTests:
    """Tests of an axis' candidates on its records; each is done once."""

    def __init__(
        self, prepared: Prepared, found: Found, evidence: Evidence, baseline: Baseline | None, configuration: Configuration
    ) -> None:
        """Keep what tests need, and do none."""
        self.evidence, self._prepared, self._found = evidence, prepared, found
        self._baseline, self._configuration = baseline, configuration
        self._residuals: dict[int, ResidualEvidence] = {}
        self._drops: dict[int, tuple[int, ...]] = {}

    def residuals(self, indices: Sequence[int]) -> dict[int, ResidualEvidence]:
        """Measure what hypotheses leave."""
        prepared, beside = self._prepared, self._baseline
        new = [index for index in indices if index not in self._residuals]
        none = self._found.none
        same = (none, prepared.findings, prepared.checks, self._configuration, self._found.temper, beside and beside.usual_zero)
        measured = map_known(_residual, [(prepared.linearized, self._found.hypotheses[index], *same) for index in new])
        self._residuals.update(zip(new, measured, strict=True))
        return {index: self._residuals[index] for index in indices}

    def dropped(self, index: int) -> tuple[int, ...]:
        """Hypotheses that baseline records rule out; or this one, if it does not hold on the record itself."""
        if index not in self._drops:
            self._drops[index] = self._dropped(index)
        return self._drops[index]

    def _dropped(self, index: int) -> tuple[int, ...]:
        best, none, linearized = self._found.hypotheses[index], self._found.none, self._prepared.linearized
        clean = self._prepared.clean
        if clean is not None and (known := clean.show(best, self.evidence.null + self._configuration.policy.margin)):
            return self._without_known(index, known)
        # Beside a baseline record of the same command no coefficient is free, and without baseline records they make up for much.
        if clean is not None and widens(linearized, best, none):
            return (index,)
        return () if holds(linearized, best, none, self._configuration.reduction) else (index,)

    def _without_known(self, index: int, known: frozenset[str]) -> tuple[int, ...]:
        """Hypotheses with effects that baseline records ask for too, and those that explain no more where these explain the gap alone."""
        evidence, policy = self.evidence, self._configuration.policy
        best = evidence.hypotheses[index]
        alone = known.issuperset(best.names)
        return tuple(
            i
            for i, one in enumerate(evidence.hypotheses)
            if i and (known.intersection(one.names) or (alone and not exceeds(best, one, evidence, policy)))
        )


def _residual(
    linearized: Linearized,
    scored: FittedHypothesis,
    none: FittedHypothesis,
    findings: Sequence[Finding],
    checks: frozenset[RecordCheck],
    configuration: Configuration,
    temper: float,
    usual: Array | None,
) -> ResidualEvidence:
    """Measure the residual of a hypothesis, beside the usual zero of a session (A, 3)."""
    zero = () if usual is None else companions(linearized, scored, usual, temper)
    distorted = distortions(linearized, scored, temper)
    seen = residual_evidence(linearized.problem, scored, findings, checks, configuration, zero, distorted)
    return replace(seen, held_out=left_out(linearized, scored, none, configuration.reduction))
