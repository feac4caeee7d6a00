# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Parts of the policy by themselves: the verdict of several axes, what is detected before a fit, practical size and strain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyst_control.diagnose.configuration import CONFIGURATION
from hyst_control.diagnose.decide.novelty import remainder
from hyst_control.diagnose.decide.policy import decide, join, practical_floor, strained
from hyst_control.diagnose.decide.record_findings import detected
from hyst_control.diagnose.noise.white import noise_of
from hyst_control.diagnose.verdict import Decision, Reason, Verdict
from test.diagnose.made_evidence import ALL, LIMITS, PLAIN, QUIET, coefficients, effect, evidence, none
from test.diagnose.policy_rows import C

NO, EFF, PAR, AMB, UNK = (
    Decision(Verdict.NO_GAP, (Reason.BELOW_NULL,), 0, (), {}, 0.0),
    Decision(Verdict.EFFECT, (Reason.ONE_EXPLANATION, Reason.RECORD_CHECK), 1, (1,), {}, 0.01),
    Decision(Verdict.PARAMETERS, (Reason.COEFFICIENTS_BEYOND_TOLERANCE,), 1, (1,), {}, 0.0),
    Decision(Verdict.AMBIGUOUS, (Reason.SEVERAL_EXPLANATIONS,), 1, (1, 2), {}, 0.05),
    Decision(Verdict.UNKNOWN, (Reason.TOO_MANY_EFFECTS,), 1, (1,), {}, 0.02),
)
LEFT = Decision(Verdict.UNKNOWN, (Reason.ENERGY_LEFT,), 0, (0,), {}, 0.5)


@pytest.mark.parametrize(
    "decisions, verdict, reasons, remainder",
    [
        ((NO, NO), Verdict.NO_GAP, NO.reasons, 0.0),
        ((NO, PAR), Verdict.PARAMETERS, PAR.reasons, 0.0),
        ((PAR, EFF), Verdict.EFFECT, EFF.reasons, 0.01),
        ((AMB, EFF), Verdict.AMBIGUOUS, AMB.reasons, 0.05),
        ((AMB, UNK, EFF), Verdict.UNKNOWN, UNK.reasons, 0.05),
        ((UNK, LEFT), Verdict.UNKNOWN, (Reason.ENERGY_LEFT, Reason.TOO_MANY_EFFECTS), 0.5),
    ],
)
def test_the_axis_that_prevails(decisions, verdict, reasons, remainder):
    for order in (decisions, decisions[::-1]):
        joint = join(order)
        assert (joint.verdict, joint.reasons, joint.remainder) == (verdict, reasons, remainder)


@pytest.mark.parametrize(
    "seen, due",
    [
        (PLAIN, ()),
        (replace(PLAIN, repeated=0.003), (C.REPEATED_VALUES,)),
        (replace(PLAIN, repeated=0.003, repeats_counted=1000), ()),
        (replace(PLAIN, repeated=0.02, step=0.01), (C.REPEATED_VALUES,)),
        (replace(PLAIN, step=1.0), (C.VALUE_LATTICE,)),
        (replace(PLAIN, step=1.0, step_modelled=True), ()),
        (replace(PLAIN, step=1.0, repeated=0.02), (C.REPEATED_VALUES, C.VALUE_LATTICE)),
    ],
)
def test_what_is_detected_before_a_fit(seen, due):
    assert tuple(finding.check for finding in detected((seen,), ALL, LIMITS)) == due
    assert not detected((seen,), (), LIMITS)


def test_the_practical_size_adds_up_in_energy():
    """Range, rounding and what the stated noise exceeds the measured one by; each against its closed form."""
    one, nought = np.ones(1), np.zeros(1)
    assert practical_floor(1e4 * one, nought, nought, one, LIMITS) == pytest.approx(1e4 * LIMITS.practical_size)
    assert practical_floor(nought, nought, np.sqrt(2.0) * one, one, LIMITS) == pytest.approx(LIMITS.stated_excess)
    assert practical_floor(nought, np.sqrt(12.0) * one, nought, one, LIMITS) == pytest.approx(LIMITS.rounding_share)
    everything = practical_floor(1e4 * one, np.sqrt(12.0) * one, np.sqrt(2.0) * one, one, LIMITS)
    assert everything == pytest.approx(
        np.sqrt((1e4 * LIMITS.practical_size) ** 2 + LIMITS.stated_excess**2 + LIMITS.rounding_share**2)
    )


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 200))
def test_coefficients_are_strained_beyond_what_their_chi_square_allows(count):
    """The chi-square has mean n and standard deviation sqrt(2 n)."""
    least = 0.5 * (count + LIMITS.strain_deviations * np.sqrt(2.0 * count))
    assert strained(least * (1 + 1e-9), count, LIMITS) and not strained(least * (1 - 1e-9), count, LIMITS)


def test_energy_beyond_the_noise_counts_from_three_standard_errors_of_its_estimate():
    """The scatter of the estimate is that of white noise of so many samples, and what is left of the gap counts once it exceeds it."""
    rows, random = 3000, np.random.default_rng(1)
    lower, upper = CONFIGURATION.noise.band
    scatter = np.std([noise_of([random.standard_normal(rows)]) ** 2 for _ in range(400)])
    for deviations, counts in ((2.5, False), (3.6, True)):
        left = replace(QUIET, energy=1.0 + deviations * scatter)
        seen = evidence(effect("delay", residual=left), floor=0.0, noise_bins=0.5 * (upper - lower) * rows)
        assert (remainder(seen, 1, LIMITS) > 0.0) == counts


@pytest.mark.parametrize("nominal, verdict", [(0.0, Verdict.UNKNOWN), (12_500.0, Verdict.PARAMETERS)])
def test_coefficients_explain_a_gap_of_the_nominal_model(nominal, verdict):
    """A pole that has moved by many tolerances: within them coefficients leave 49 noise energies of 12,500, and beyond them 17."""
    seen = evidence(coefficients(left=17.0, farthest=190.0), base=none(energy=49.0), nominal=nominal)
    assert decide(seen, LIMITS).verdict is verdict
