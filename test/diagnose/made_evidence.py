# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Evidence made up for tests of the policy: a plain record, and what one row of the table changes in it."""

from __future__ import annotations

from dataclasses import replace

from hyst_control.diagnose.configuration import CONFIGURATION
from hyst_control.diagnose.evidence import (
    CompanionEvidence,
    Evidence,
    FlickerEvidence,
    HypothesisEvidence,
    RecordEvidence,
    ResidualEvidence,
)
from hyst_control.effects.effect import RecordCheck

LIMITS = replace(
    CONFIGURATION.policy,
    margin=3.0,
    sharpness=0.25,
    sure_probability=0.85,
    listed_probability=0.05,
    unknown_share=0.06,
    named_unexplained_share=0.1,
    novelty_threshold=1.0,
    max_effects=2,
    many_tolerances=8.0,
    added_share=0.002,
    min_excess=0.1,
    own_error_share=0.5,
    own_error_energy=1.5,
    noise_own_share=0.01,
    run_to_run=4.0,
    stuck=2,
)
"""The values that the rows below were made for, so that tuning changes no row."""

NULL = 10.0
BEFORE = 101.0
SAMPLES = 20000
MISFIT = 0.5 * SAMPLES * BEFORE
QUIET = ResidualEvidence(1.0, (1.0,), (0,), (0.0,))
PLAIN = RecordEvidence(SAMPLES, 0.0, SAMPLES, 0.0, 0.0, False, 1.0)
ALL = frozenset(RecordCheck)


def none(**changes) -> HypothesisEvidence:
    """No effect: it leaves a hundred noise energies beyond the noise's."""
    return replace(HypothesisEvidence((), False, 0.0, MISFIT, BEFORE, 0.0, replace(QUIET, energy=BEFORE)), **changes)


def effect(name: str, score: float = 1000.0, left: float = 1.0, **changes) -> HypothesisEvidence:
    """Effects by their names joined with "+", which leave so much energy."""
    misfit, residual = 0.5 * SAMPLES * left, replace(QUIET, energy=left)
    found = HypothesisEvidence(tuple(name.split("+")), False, score, misfit, left, 0.0, residual)
    return replace(found, **changes)


def coefficients(score: float = 1000.0, left: float = 1.0, **changes) -> HypothesisEvidence:
    """Coefficients alone, beyond their tolerance."""
    return replace(effect("", score, left), names=(), coefficients_alone=True, **changes)


def evidence(*others: HypothesisEvidence, base: HypothesisEvidence | None = None, **changes) -> Evidence:
    """One axis with white noise of the stated size, and these hypotheses beside "no effect"."""
    found = Evidence(
        (none() if base is None else base, *others), 1.0, 10, NULL, 0.5, 1.0, (1.0,), (1.0,), SAMPLES, 0.2 * SAMPLES, (PLAIN,), ALL
    )
    return replace(found, **changes)


def flicker(gain: float, rms: float = 3.0, top: float = 0.1, plausible: bool = True) -> FlickerEvidence:
    return FlickerEvidence(rms, (0.8 * rms, 1.2 * rms), 1.0, gain, plausible, top)


FALLING = replace(QUIET, energy=50.0, flicker=flicker(1e7))


SPIKES = replace(QUIET, white=(2.0,), outliers=(50,), outliers_rms=(1.7,))


SMALL = none(misfit=0.5 * SAMPLES * 1.2, energy=1.2, residual=replace(QUIET, energy=1.2))


OUTLIERS_BASE = none(energy=3.0, residual=replace(SPIKES, energy=1.0))


UNRELATED = none(residual=replace(QUIET, energy=BEFORE, predictable=0.0))


def session(usual: float) -> HypothesisEvidence:
    """No gap but a zero of two noise rms, where baseline records differ by `usual`."""
    zero = CompanionEvidence("offset", "offset", 0, 2.0, 0.1, usual, 2.0)
    return replace(SMALL, residual=replace(QUIET, energy=1.2, companions=(zero,)))
