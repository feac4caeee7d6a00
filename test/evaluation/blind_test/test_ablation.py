# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Ablation of the policy: a moved threshold changes the verdicts that it decides, and every threshold and rule has its move."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from evaluation.blind_test.ablation import BEFORE, RULES, changes, moves, outcomes, without
from evaluation.blind_test.case import Case, Label
from hyst_control.diagnose.evidence import Evidence, ResidualEvidence
from test.diagnose.made_evidence import LIMITS, coefficients, effect, evidence

CASE = Case("case", "pea_published", "single", "rich", 0.0, 1, label=Label("single", ("a",)))
CLAIMS = evidence(effect("a"), effect("b", 999.0), coefficients(0.0))


@dataclass(frozen=True)
class Measured:
    """Tests whose residuals are those of made-up evidence."""

    evidence: Evidence

    def residuals(self, indices: Sequence[int]) -> dict[int, ResidualEvidence]:
        found = {index: self.evidence.hypotheses[index].residual for index in indices}
        assert None not in found.values()
        return found


def test_a_move_changes_the_cases_that_it_decides():
    """Both names are as probable: the margin of a claim is not what tells them, the probability that is sure is."""
    usual, *others = outcomes(CASE, [(CLAIMS, Measured(CLAIMS))])
    assert usual.names == ("a", "b") and usual.right
    found = changes([[usual, *others]])
    assert found["sure_probability x 0.5"] == (1, 0, 0) and found["margin x 0.5"] == (0, 0, 0)
    assert found["margin x 1e+06"] == (1, 0, 1)


def test_every_threshold_is_moved_both_ways_and_every_rule_is_off_once():
    named = [one.name for one in moves(LIMITS)]
    assert len(named) == len(set(named))
    assert {name.split()[0] for name in named if " x " in name} == set(vars(LIMITS)) - BEFORE
    for name, rule in RULES.items():
        module, attribute, off = rule
        usual = getattr(module, attribute)
        with without(rule):
            assert getattr(module, attribute) is off, name
        assert getattr(module, attribute) is usual
