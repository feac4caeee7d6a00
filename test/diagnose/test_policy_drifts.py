# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A drift beside an effect that would have to change with time without it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from hyst_control.diagnose.decide.policy import contenders, decide
from hyst_control.diagnose.evidence import DistortionEvidence, Evidence
from hyst_control.diagnose.verdict import Verdict
from test.diagnose.made_evidence import (
    LIMITS,
    NULL,
    QUIET,
    SAMPLES,
    changing,
    effect,
    evidence,
)
from test.diagnose.policy_rows import V


def drifting(adds: float, statistic: float = 100.0, variable: str = "time", left: Sequence[DistortionEvidence] = ()) -> Evidence:
    """An effect that changes with time, and the same with a drift, which takes `adds` of the noise's energy off besides."""
    tested = replace(QUIET, energy=2.0 - adds, distortions=tuple(left))
    return evidence(
        replace(changing(0.8, statistic, variable=variable), misfit=SAMPLES, beyond=SAMPLES, energy=2.0),
        effect("a+drift", 1400.0, left=2.0 - adds, residual=tested),
        whitened=True,
        drifts=frozenset({"drift"}),
    )


def named(found: Evidence) -> tuple[Verdict, tuple[str, ...]]:
    decision = decide(found, LIMITS)
    return decision.verdict, tuple("+".join(found.hypotheses[index].names) for index in decision.listed)


def test_a_drift_is_named_beside_an_effect_that_would_have_to_change_with_time():
    """It adds 1 % to what the effect takes off, less than the share that a detail must add, but a test asks for just that."""
    assert named(drifting(1.0)) == (V.EFFECT, ("a+drift",))
    assert named(replace(drifting(1.0), drifts=frozenset())) == (V.UNKNOWN, ("a",))
    assert named(drifting(1.0, statistic=1.0)) == (V.EFFECT, ("a",))  # nothing asks for it
    assert named(drifting(1.0, variable="level")) == (V.UNKNOWN, ("a",))  # a drift is no answer to that
    # The test is one of a: beside another effect, which alone is worse, a drift remains a detail.
    other = (effect("b", 900.0, left=2.1), effect("b+drift", 1500.0, left=0.9))
    found = drifting(1.0)
    assert named(replace(found, hypotheses=(*found.hypotheses, *other))) == (V.EFFECT, ("a+drift",))


def test_a_drift_that_is_no_cure_is_not_named():
    """It adds less than a claim needs, or an effect would still have to change."""
    assert named(drifting(0.5 * NULL / (0.5 * SAMPLES))) == (V.UNKNOWN, ("a",))
    still = DistortionEvidence("a", "time", 0.8, 50.0, 0.03)
    assert named(drifting(1.0, left=(still,))) == (V.UNKNOWN, ("a",))


def test_the_pair_that_a_test_asks_for_is_tested_too():
    found = drifting(1.0)
    bare = replace(found, hypotheses=(*found.hypotheses[:2], replace(found.hypotheses[2], residual=None)))
    assert contenders(bare, LIMITS) == (0, 2)


def test_an_effect_that_becomes_the_better_one_at_an_end_of_its_ranges_is_no_second_explanation():
    """A drift that ended at once is a constant change: what else the drift could be, the data do not ask for."""
    ends = (("drift", "a"),)
    both = evidence(effect("a", 1000.0), effect("drift", 999.0), ends_as=ends)
    assert named(both) == (V.EFFECT, ("a",))
    assert named(replace(both, ends_as=())) == (V.AMBIGUOUS, ("a", "drift"))
    assert named(evidence(effect("drift", 1000.0), effect("a", 999.0), ends_as=ends)) == (V.AMBIGUOUS, ("drift", "a"))
    pair = evidence(effect("a+b", 1000.0), effect("b+drift", 999.0), effect("c", 999.0), ends_as=ends)
    assert named(pair) == (V.AMBIGUOUS, ("a+b", "c"))
