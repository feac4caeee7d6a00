# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The policy as a table: numbers in, verdict and reasons out."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from hyst_control.diagnose.decide.policy import contenders, decide
from hyst_control.diagnose.verdict import Reason, Verdict
from test.diagnose.made_evidence import BEFORE, LIMITS, coefficients, effect, evidence, none
from test.diagnose.policy_rows import V
from test.diagnose.policy_rows_of_fits import ROWS as FITS
from test.diagnose.policy_rows_of_records import ROWS as RECORDS

TABLE = (*FITS, *RECORDS)


@pytest.mark.parametrize("row", TABLE, ids=lambda row: row.rule)
def test_rule(row):
    decision = decide(row.evidence, LIMITS)
    assert (decision.verdict, decision.reasons) == (row.verdict, row.reasons)
    assert tuple("+".join(row.evidence.hypotheses[index].names) for index in decision.listed) == row.listed
    assert tuple(finding.check for finding in decision.findings) == row.checks
    if row.remainder is not None:
        assert decision.remainder == pytest.approx(row.remainder, rel=1e-9)


def test_every_reason_is_in_the_manual():
    text = (Path(__file__).resolve().parents[2] / "docs" / "diagnosis.md").read_text(encoding="utf-8")
    assert not [reason.value for reason in Reason if f"`{reason.value}`" not in text]


def test_every_reason_has_a_row():
    of_rules = set(Reason) - {Reason.SOMETHING_ELSE}  # which only the other core says
    assert {reason for row in TABLE for reason in row.reasons} == of_rules
    assert {row.verdict for row in TABLE} == set(Verdict)


@pytest.mark.parametrize("row", TABLE, ids=lambda row: row.rule)
def test_the_novelty_score_exceeds_one_half_where_a_rule_says_unknown(row):
    decision = decide(row.evidence, LIMITS)
    assert (decision.novelty > 0.5) == (row.verdict is V.UNKNOWN)


def test_cases_short_of_every_threshold_are_in_order():
    """The remainder is 0 in both, and the one that leaves more is the newer."""
    little, more = (decide(evidence(effect("a", left=1.0 + left)), LIMITS) for left in (0.02, 0.08))
    assert little.remainder == more.remainder == 0.0
    assert 0.0 < little.novelty < more.novelty < 0.5


@pytest.mark.parametrize("row", TABLE, ids=lambda row: row.rule)
def test_the_verdict_is_unknown_beyond_the_conformal_threshold_alone(row):
    """Between a half and twice the threshold of a rule, the calibrated one decides; the score has it at one half."""
    for threshold in (0.5, 2.0):
        decision = decide(row.evidence, replace(LIMITS, novelty_threshold=threshold))
        usual = decide(row.evidence, LIMITS)
        assert (decision.novelty > 0.5) == (decision.verdict is V.UNKNOWN)
        if Reason.AT_BOUND not in usual.reasons and decision.verdict is not usual.verdict:
            assert V.UNKNOWN in (decision.verdict, usual.verdict)
            clearest = usual.novelty / (1.0 - usual.novelty)
            assert min(1.0, threshold) < clearest <= max(1.0, threshold) + 1e-9


def test_a_little_more_than_a_rule_allows_is_unknown_by_that_rule_and_known_by_a_wider_threshold():
    over = evidence(effect("a", left=1.0 + 0.09 * (BEFORE - 1.0)))  # 9 % of the gap's energy; the rule is 6 %
    decisions = [decide(over, replace(LIMITS, novelty_threshold=threshold)) for threshold in (1.0, 1.6)]
    assert [one.verdict for one in decisions] == [V.UNKNOWN, V.EFFECT]
    assert decisions[0].novelty == pytest.approx(1.5 / 2.5) and decisions[1].novelty == pytest.approx(1.5 / 3.1)


def test_nothing_is_decided_without_the_residual_of_a_contender():
    bare = evidence(effect("a", residual=None), coefficients(), effect("b", 500.0, residual=None))
    assert contenders(bare, LIMITS) == (0, 1, 2)
    with pytest.raises(ValueError, match="hypothesis 1"):
        decide(bare, LIMITS)


def test_what_coefficients_take_up_far_beyond_their_tolerance_is_unexplained():
    """Ten times as far as is believed: (1 - 1/10)² of the energy is left by what is believed."""
    far = 10.0 * LIMITS.many_tolerances
    found = decide(evidence(coefficients(farthest=far), base=none(strain=500.0)), LIMITS)
    assert (found.verdict, found.remainder) == (Verdict.PARAMETERS, 0.0)
    assert found.unexplained == pytest.approx(0.81)
    near = decide(evidence(coefficients(farthest=0.9 * LIMITS.many_tolerances), base=none(strain=500.0)), LIMITS)
    assert near.unexplained == 0.0
    taken_up = decide(evidence(coefficients(farthest=far), base=none(energy=1.03, strain=500.0)), LIMITS)
    assert taken_up.unexplained == pytest.approx(0.81)  # also where the tolerances alone, strained, leave nothing


def test_a_remainder_too_small_for_a_verdict_is_still_told():
    found = decide(evidence(effect("a", left=1.05)), LIMITS)
    assert (found.verdict, found.remainder) == (Verdict.EFFECT, 0.0)
    assert found.unexplained == pytest.approx(0.05 / (BEFORE - 1.0))


def test_of_realizations_that_are_alike_only_the_best_counts():
    """Eight holds of one command as good as one delay: the hold is no likelier for being told in eight ways."""
    found = decide(evidence(effect("delay"), *(effect("dac_hold", 999.99) for _ in range(8))), LIMITS)
    assert found.probability[("delay",)] > found.probability[("dac_hold",)]
