# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The policy on any numbers: what a decision is consistent with, and what it does not depend on."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyst_control.diagnose.decide.policy import contenders, decide, join
from hyst_control.diagnose.evidence import Evidence, ResidualEvidence
from hyst_control.diagnose.verdict import Verdict
from hyst_control.effects.effect import RecordCheck
from test.diagnose.made_evidence import ALL, LIMITS, PLAIN, SAMPLES, coefficients, effect, evidence, flicker, none

ENERGY = st.floats(1.0, 120.0)
SCORE = st.floats(-20.0, 2000.0)


@st.composite
def any_evidence(draw) -> Evidence:
    """Evidence of one or two axes with up to six hypotheses whose scores differ."""
    axes = draw(st.integers(1, 2))
    names = draw(st.lists(st.sampled_from(("a", "b", "c", "d", "a+b", "a+b+c", "b+d")), unique=True, max_size=6))
    scores = draw(st.lists(SCORE, min_size=len(names) + 1, max_size=len(names) + 1, unique=True))

    def residual(energy: float) -> ResidualEvidence:
        count = draw(st.sampled_from((0, 50, 5000)))
        noise = flicker(draw(st.floats(0.0, 1e6)), draw(st.floats(0.05, 5.0)), draw(st.floats(0.0, 1.0)))
        spikes = draw(st.floats(0.0, 3.0))
        white = draw(st.floats(0.5, 3.0))
        return ResidualEvidence(energy, (white,) * axes, (count,) * axes, (spikes,) * axes, noise if axes == 1 else None)

    def left() -> dict:
        energy = draw(ENERGY)
        strain = draw(st.floats(0.0, 60.0))
        return {"misfit": 0.5 * SAMPLES * energy, "energy": energy, "strain": strain, "residual": residual(energy)}

    others = [replace(effect(name, score), **left()) for name, score in zip(names, scores, strict=False)]
    if draw(st.booleans()):
        others.append(replace(coefficients(scores[-1]), **left()))
    seen = replace(PLAIN, repeated=draw(st.sampled_from((0.0, 0.1))), step=draw(st.sampled_from((0.0, 1.0))))
    return evidence(
        *others,
        base=none(**left()),
        temper=draw(st.floats(0.01, 1.0)),
        null=draw(st.floats(0.0, 50.0)),
        floor=draw(st.floats(0.0, 5.0)),
        stated=draw(st.floats(1.0, 3.0)),
        noise=(1.0,) * axes,
        stated_noise=(draw(st.sampled_from((0.0, 1.0))),) * axes,
        record=(seen,) * axes,
        checks=frozenset(draw(st.sets(st.sampled_from(sorted(ALL, key=str))))),
    )


@settings(max_examples=60, deadline=None)
@given(any_evidence())
def test_a_decision_is_consistent(found):
    decision = decide(found, LIMITS)
    assert decision.reasons and 0.0 <= decision.remainder <= 1.0 and 0.0 <= decision.novelty <= 1.0
    assert (decision.novelty > 0.5) == (decision.verdict is Verdict.UNKNOWN)
    assert sum(decision.probability.values()) == pytest.approx(1.0)
    assert {finding.check for finding in decision.findings} <= found.checks
    assert join([decision]).verdict is decision.verdict and join([decision]).reasons == decision.reasons
    assert {0, decision.chosen} <= set(contenders(found, LIMITS))
    fitted = any(found.hypotheses[index].names for index in decision.listed)
    named = fitted or bool(decision.findings)
    assert named or decision.verdict is not Verdict.EFFECT
    assert not fitted or decision.verdict in (Verdict.EFFECT, Verdict.AMBIGUOUS, Verdict.UNKNOWN)
    assert not named or decision.verdict is not Verdict.NO_GAP


@settings(max_examples=60, deadline=None)
@given(any_evidence(), st.floats(1e-6, 1e6))
def test_the_unit_of_the_measurement_does_not_matter(found, scale):
    """All that is in the measurement's unit times a factor: the same decision, and findings by that factor."""

    def scaled(one: ResidualEvidence) -> ResidualEvidence:
        return replace(one, white=tuple(scale * v for v in one.white), outliers_rms=tuple(scale * v for v in one.outliers_rms))

    other = replace(
        found,
        hypotheses=tuple(replace(one, residual=scaled(one.residual)) for one in found.hypotheses),
        noise=tuple(scale * v for v in found.noise),
        stated_noise=tuple(scale * v for v in found.stated_noise),
        record=tuple(
            replace(one, repeated_rms=scale * one.repeated_rms, step=scale * one.step, noise=scale * one.noise)
            for one in found.record
        ),
    )
    here, there = decide(found, LIMITS), decide(other, LIMITS)
    assert (here.verdict, here.reasons, here.listed) == (there.verdict, there.reasons, there.listed)
    assert here.remainder == pytest.approx(there.remainder)
    for one, two in zip(here.findings, there.findings, strict=True):
        factor = 1.0 if one.check is RecordCheck.REPEATED_VALUES else scale
        assert two.value == pytest.approx(factor * one.value)


@settings(max_examples=60, deadline=None)
@given(any_evidence(), st.data())
def test_the_order_of_hypotheses_does_not_matter(found, data):
    order = [0, *data.draw(st.permutations(range(1, len(found.hypotheses))))]
    here, there = decide(found, LIMITS), decide(replace(found, hypotheses=tuple(found.hypotheses[i] for i in order)), LIMITS)
    assert (here.verdict, here.reasons, here.remainder) == (there.verdict, there.reasons, there.remainder)
    assert here.listed == tuple(order[index] for index in there.listed)
    assert here.probability == pytest.approx(there.probability)


@settings(max_examples=60, deadline=None)
@given(any_evidence())
def test_the_order_of_axes_does_not_matter(found):
    """Two axes of which one has the other's record, stated noise and residuals, and the same the other way round."""
    quiet = replace(PLAIN, noise=1.0)

    def axes(first: bool) -> Evidence:
        def pair(one, other) -> tuple:
            return (one, other) if first else (other, one)

        residuals = {
            index: replace(
                one.residual,
                white=pair(one.residual.white[0], 1.0),
                outliers=pair(one.residual.outliers[0], 0),
                outliers_rms=pair(one.residual.outliers_rms[0], 0.0),
                flicker=None,
            )
            for index, one in enumerate(found.hypotheses)
        }
        return replace(
            found, noise=(1.0, 1.0), stated_noise=pair(found.stated_noise[0], 1.0), record=pair(found.record[0], quiet)
        ).with_residuals(residuals)

    here, there = decide(axes(True), LIMITS), decide(axes(False), LIMITS)
    assert (here.verdict, here.reasons, here.remainder, here.listed) == (
        there.verdict,
        there.reasons,
        there.remainder,
        there.listed,
    )
    assert {(one.check, one.axis) for one in here.findings} == {(one.check, 1 - one.axis) for one in there.findings}


@settings(max_examples=60, deadline=None)
@given(any_evidence(), st.floats(1.0, 50.0))
def test_more_energy_left_never_turns_unknown_into_something_known(found, more):
    """Every hypothesis leaves more than its effects leave by nature; nothing else changes."""
    worse = found.with_residuals(
        {i: replace(one.residual, energy=more * one.residual.energy) for i, one in enumerate(found.hypotheses)}
    )
    here, there = decide(found, LIMITS), decide(worse, LIMITS)
    assert there.remainder >= here.remainder
    assert here.verdict is not Verdict.UNKNOWN or there.verdict is Verdict.UNKNOWN


@settings(max_examples=60, deadline=None)
@given(any_evidence(), st.floats(0.0, 500.0))
def test_a_higher_null_makes_no_new_claim(found, more):
    """Without a second effect that is better than the first by what a claim needs, which depends on the null the other way round."""
    singles = replace(found, hypotheses=tuple(one for one in found.hypotheses if len(one.names) < 2), checks=frozenset())
    here, there = decide(singles, LIMITS), decide(replace(singles, null=singles.null + more), LIMITS)
    assert set(there.probability) - {()} <= set(here.probability)
