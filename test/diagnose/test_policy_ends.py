# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""An effect that becomes a simpler one at an end of its ranges."""

from __future__ import annotations

from dataclasses import replace

from hyst_control.diagnose.decide.policy import decide
from hyst_control.diagnose.evidence import Evidence
from hyst_control.diagnose.verdict import Verdict
from test.diagnose.made_evidence import LIMITS, effect, evidence
from test.diagnose.policy_rows import V


def named(found: Evidence) -> tuple[Verdict, tuple[str, ...]]:
    decision = decide(found, LIMITS)
    return decision.verdict, tuple("+".join(found.hypotheses[index].names) for index in decision.listed)


def test_an_effect_that_becomes_the_better_one_at_an_end_of_its_ranges_is_no_second_explanation():
    """A drift that ended at once is a constant change: what else the drift could be, the data do not ask for."""
    ends = (("drift", "a"),)
    both = evidence(effect("a", 1000.0), effect("drift", 999.0), ends_as=ends)
    assert named(both) == (V.EFFECT, ("a",))
    assert named(replace(both, ends_as=())) == (V.AMBIGUOUS, ("a", "drift"))
    assert named(evidence(effect("drift", 1000.0), effect("a", 999.0), ends_as=ends)) == (V.EFFECT, ("a",))
    assert named(evidence(effect("drift", 1000.0), effect("a", 900.0, left=1.4), ends_as=ends)) == (V.EFFECT, ("drift",))
    several = (*ends, ("drift", "c"))
    assert named(evidence(effect("drift", 1000.0), effect("c", 999.0), ends_as=several)) == (V.EFFECT, ("c",))
    pair = evidence(effect("a+b", 1000.0), effect("b+drift", 999.0), effect("c", 999.0), ends_as=ends)
    assert named(pair) == (V.AMBIGUOUS, ("a+b", "c"))
