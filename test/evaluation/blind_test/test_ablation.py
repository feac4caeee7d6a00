# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Replay of stored evidence: the numbers come back as they were, and a moved threshold changes the verdicts that it decides."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from evaluation.blind_test.ablation import AS_IT_IS, BEFORE, RULES, NotMeasured, StoredTests, ablated, made, moves, outcome, without
from evaluation.blind_test.case import Case, Label
from evaluation.blind_test.run import plain
from hyst_control.diagnose.evidence import Evidence, ResidualEvidence
from test.diagnose.made_evidence import LIMITS, coefficients, effect, evidence
from test.diagnose.policy_rows_of_fits import ROWS as FITS
from test.diagnose.policy_rows_of_records import ROWS as RECORDS

CASE = Case("case", "pea_published", "single", "rich", 0.0, 1, label=Label("single", ("a",)))
CLAIMS = evidence(effect("a"), effect("b", 999.0), coefficients(0.0))


def stored(seen: Evidence) -> StoredTests:
    residuals = {i: made(ResidualEvidence, json.loads(json.dumps(plain(one.residual)))) for i, one in enumerate(seen.hypotheses)}
    return StoredTests(residuals, {})


@pytest.mark.parametrize("row", (*FITS, *RECORDS), ids=lambda row: row.rule)
def test_evidence_is_the_same_after_it_was_stored(row):
    again = made(Evidence, json.loads(json.dumps(plain(row.evidence))))
    assert repr(again.hypotheses) == repr(row.evidence.hypotheses)  # NaN is not equal to itself
    assert replace(again, hypotheses=()) == replace(row.evidence, hypotheses=())


def test_a_move_changes_the_cases_that_it_decides():
    """Both names are as probable: the margin of a claim is not what tells them, the probability that is sure is."""
    cases = {"case": (CASE, [(CLAIMS, stored(CLAIMS))], outcome(CASE, [(CLAIMS, stored(CLAIMS))], AS_IT_IS))}
    assert cases["case"][2].names == ("a", "b") and cases["case"][2].right
    found = {one.move: one for one in ablated(cases)}
    assert found["sure_probability x 0.5"].changed == 1 and found["margin x 0.5"].changed == 0
    assert found["margin x 1e+06"].worse == 1 and found["sure_probability x 0.5"].worse == 0
    assert {one.unmeasured for one in found.values()} == {0}


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


def test_a_test_that_was_not_stored_is_no_verdict():
    with pytest.raises(NotMeasured):
        StoredTests({}, {}).residual(0)
    bare = evidence(effect("a", residual=None))
    with pytest.raises(NotMeasured):
        outcome(CASE, [(bare, StoredTests({}, {}))], AS_IT_IS)
