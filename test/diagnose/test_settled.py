# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""From evidence to a decision: explanations that do not hold are dropped in turn, and what baseline records explain leaves nothing new."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

from hyst_control.diagnose.configuration import CONFIGURATION
from hyst_control.diagnose.run.settle import VETOES, ContenderTests, settled
from hyst_control.diagnose.verdict import Verdict
from test.diagnose.made_evidence import LIMITS, QUIET, effect, evidence, none

WITHIN = none(energy=0.9, residual=replace(QUIET, energy=0.9))
"""A gap no larger than the model discrepancy."""


class Refusing:
    """Tests in which the first explanations do not hold."""

    def __init__(self, refused: int) -> None:
        self.refused, self.asked = refused, []

    def residuals(self, indices):
        return dict.fromkeys(indices, QUIET)

    def dropped(self, index):
        self.asked.append(index)
        return (index,) if len(self.asked) <= self.refused else ()


def many():
    """Explanations a, b, c …, each a little worse than the one before."""
    return evidence(*(effect(name, 1000.0 - 20.0 * i, left=0.5) for i, name in enumerate("abcdefgh")), base=WITHIN, whitened=True)


def test_an_explanation_that_does_not_hold_gives_way_to_the_next():
    tests = Refusing(2)
    found, decision = settled(many(), tests, LIMITS)
    assert found.hypotheses[decision.chosen].names == ("c",) and tests.asked == [1, 2, 3]


def test_after_many_that_do_not_hold_none_is_named_untested():
    tests = Refusing(100)
    found, decision = settled(many(), tests, LIMITS)
    assert len(tests.asked) == VETOES and decision.verdict is Verdict.NO_GAP and found.hypotheses[decision.chosen].names == ()


def test_what_baseline_records_ask_for_leaves_only_what_explains_more():
    """Misfits: a 0.5, b 0.6 and c 0.4 energies; c alone exceeds a by more than chance."""
    made = evidence(effect("a", left=0.5), effect("b", left=0.6), effect("c", left=0.4), effect("a+b", left=0.4), whitened=True)
    tests = SimpleNamespace(evidence=made, _configuration=CONFIGURATION)
    assert ContenderTests._without_known(tests, 1, frozenset("a")) == (1, 2, 4)
    assert ContenderTests._without_known(tests, 4, frozenset("a")) == (1, 4)  # of a pair the part that is not known may be new
