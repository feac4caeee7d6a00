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
    assert named(evidence(effect("drift", 1000.0), effect("a", 999.0), ends_as=ends)) == (V.AMBIGUOUS, ("drift", "a"))
    pair = evidence(effect("a+b", 1000.0), effect("b+drift", 999.0), effect("c", 999.0), ends_as=ends)
    assert named(pair) == (V.AMBIGUOUS, ("a+b", "c"))


def test_a_plainer_effect_that_leaves_noise_is_named_before_one_that_gains_next_to_nothing():
    """Beside a large effect, the difference between its stage and the physics is much larger than the scatter of the noise."""
    pairs = (("mode", "share"), ("mode", "gain"))
    mode = effect("mode", 1000.0, left=0.95)
    both = evidence(mode, effect("share", 900.0), plainer=pairs)
    assert named(both) == (V.EFFECT, ("share",))
    assert named(replace(both, plainer=())) == (V.EFFECT, ("mode",))
    assert named(evidence(mode, effect("share", 900.0, left=1.6), plainer=pairs)) == (
        V.EFFECT,
        ("mode",),
    )  # it leaves more than noise
    assert named(evidence(effect("mode", 1000.0), effect("gain", 999.0), plainer=pairs)) == (V.AMBIGUOUS, ("mode", "gain"))
