"""The policy as a table: numbers in, verdict and reasons out; and what holds for any numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyst_control.diagnose.evidence import DistortionEvidence, Evidence
from hyst_control.diagnose.policy import contenders, decide, join, practical_floor, strained
from hyst_control.diagnose.record_findings import detected
from hyst_control.diagnose.verdict import Decision, Reason, Verdict
from hyst_control.effects.effect import RecordCheck
from test.diagnose.made_evidence import (
    ALL,
    BEFORE,
    FALLING,
    LIMITS,
    MISFIT,
    NULL,
    OUTLIERS_BASE,
    PLAIN,
    QUIET,
    SAMPLES,
    SMALL,
    SPIKES,
    UNRELATED,
    changing,
    coefficients,
    effect,
    evidence,
    flicker,
    none,
    session,
)


@dataclass(frozen=True)
class Row:
    """One rule: evidence, and the verdict, reasons, names listed and checks that found something that are due."""

    rule: str
    evidence: Evidence
    verdict: Verdict
    reasons: tuple[Reason, ...]
    listed: tuple[str, ...] = ()
    checks: tuple[RecordCheck, ...] = ()
    remainder: float | None = field(default=None)


V, R, C = Verdict, Reason, RecordCheck
TABLE = (
    Row(
        "an effect at the end of its range, alone",
        evidence(effect("backlash", at_bound=True)),
        V.UNKNOWN,
        (R.AT_BOUND,),
        ("backlash",),
    ),
    Row(
        "an effect at the end of its range, beside another",
        evidence(effect("backlash", at_bound=True), effect("gain")),
        V.AMBIGUOUS,
        (R.SEVERAL_EXPLANATIONS,),
        ("backlash", "gain"),
    ),
    Row(
        "single samples that are all of a noise that nobody states",
        evidence(base=none(energy=1.0, residual=replace(QUIET, outliers=(8,), outliers_rms=(0.95,))), stated_noise=(0.0,)),
        V.UNKNOWN,
        (R.ENERGY_LEFT, R.OUTLIERS),
    ),
    Row(
        "an effect, and coefficients far away beside it",
        evidence(effect("a", farthest=16.0)),
        V.UNKNOWN,
        (R.UNEXPLAINED_SHARE,),
        ("a",),
        remainder=0.0,
    ),
    Row(
        "an effect, and coefficients nearly as far as is believed",
        evidence(effect("a", farthest=9.0)),
        V.EFFECT,
        (R.ONE_EXPLANATION,),
        ("a",),
    ),
    Row(
        "coefficients alone far away",
        evidence(coefficients(farthest=40.0)),
        V.PARAMETERS,
        (R.COEFFICIENTS_BEYOND_TOLERANCE,),
        ("",),
    ),
    Row(
        "an effect that leaves the model's own error as it passes it on",
        evidence(effect("a", left=16.0, residual=replace(QUIET, energy=16.0, passed=2.25)), stated=8.0),
        V.EFFECT,
        (R.ONE_EXPLANATION,),
        ("a",),
        remainder=0.0,
    ),
    Row(
        "an effect that leaves as much and passes nothing on",
        evidence(effect("a", left=16.0, residual=replace(QUIET, energy=16.0)), stated=8.0),
        V.UNKNOWN,
        (R.ENERGY_LEFT,),
        ("a",),
    ),
    Row("a session's zero larger than usual", evidence(base=session(1.0)), V.EFFECT, (R.SESSION_DIFFERS,)),
    Row(
        "no more is left than the model leaves on clean records",
        evidence(effect("delay"), stated=120.0, weight=0.01),
        V.NO_GAP,
        (R.BELOW_PRACTICAL_SIZE,),
    ),
    Row(
        "more is left than the model leaves on clean records",
        evidence(effect("delay"), stated=60.0, weight=0.01),
        V.EFFECT,
        (R.ONE_EXPLANATION,),
        ("delay",),
    ),
    Row(
        "coefficients that an effect relieves, with no more left than usual",
        evidence(effect("delay"), base=none(strain=500.0), stated=120.0, weight=0.01),
        V.EFFECT,
        (R.ONE_EXPLANATION,),
        ("delay",),
    ),
    Row(
        "three effects of which two explain nearly all",
        evidence(effect("delay+gain+creep", 1000.0, 1.0), effect("delay+gain", 900.0, 3.0)),
        V.EFFECT,
        (R.ONE_EXPLANATION,),
        ("delay+gain+creep",),
    ),
    Row("a usual zero", evidence(base=session(3.0)), V.NO_GAP, (R.BELOW_NULL,)),
    Row("a zero, and nothing says what is usual", evidence(base=session(np.nan)), V.NO_GAP, (R.BELOW_NULL,)),
    Row("a remainder that does not follow the command", evidence(base=UNRELATED), V.NO_GAP, (R.BELOW_NULL,), remainder=0.0),
    Row("as much as that varies from run to run", evidence(base=UNRELATED, stated=30.0), V.NO_GAP, (R.BELOW_NULL,), remainder=0.0),
    Row("a disturbance beyond what clean records show", evidence(base=UNRELATED, stated=2.0), V.UNKNOWN, (R.ENERGY_LEFT,), ("",)),
    Row("an effect that explains a tenth of the gap at most", evidence(effect("a", left=92.0)), V.UNKNOWN, (R.ENERGY_LEFT,), ("",)),
    Row("an effect that changes with the level", evidence(changing(-0.8)), V.UNKNOWN, (R.DISTORTION_LEVEL,), ("a",)),
    Row("an effect that changes with time", evidence(changing(0.8, variable="time")), V.UNKNOWN, (R.DISTORTION_TIME,), ("a",)),
    Row("an effect that changes with the rate", evidence(changing(0.8, variable="rate")), V.UNKNOWN, (R.DISTORTION_RATE,), ("a",)),
    Row("an effect of one direction", evidence(changing(2.0, variable="branch")), V.UNKNOWN, (R.DISTORTION_BRANCH,), ("a",)),
    Row("a change within the model's own error", evidence(changing(0.8, left=1.05)), V.EFFECT, (R.ONE_EXPLANATION,), ("a",)),
    Row("an effect that changes a little", evidence(changing(0.3)), V.EFFECT, (R.ONE_EXPLANATION,), ("a",)),
    Row("a change that may be chance", evidence(changing(0.8, NULL + 2.0)), V.EFFECT, (R.ONE_EXPLANATION,), ("a",)),
    Row(
        "a change beyond its own chance, where the own error's spectrum is known",
        evidence(changing(0.8, 9.0, left=0.6, variable="time"), whitened=True),
        V.UNKNOWN,
        (R.DISTORTION_TIME,),
        ("a",),
    ),
    Row(
        "a change within its own chance, where the own error's spectrum is known",
        evidence(changing(0.8, 6.0, left=0.6), whitened=True),
        V.EFFECT,
        (R.ONE_EXPLANATION,),
        ("a",),
    ),
    Row("a change that explains little", evidence(changing(0.8, share=0.005)), V.EFFECT, (R.ONE_EXPLANATION,), ("a",)),
    Row("nothing was tried", evidence(base=SMALL), V.NO_GAP, (R.BELOW_NULL,), remainder=0.0),
    Row(
        "an effect at the null's threshold",
        evidence(effect("a", 1.0, misfit=MISFIT - NULL - 3.0), base=SMALL),
        V.NO_GAP,
        (R.BELOW_NULL,),
    ),
    Row(
        "an effect beyond the threshold, of no practical size",
        evidence(effect("a", 20.0, 1.0, misfit=SMALL.misfit - 14.0), base=SMALL),
        V.NO_GAP,
        (R.BELOW_PRACTICAL_SIZE,),
    ),
    Row(
        "an effect of no practical size that relieves the coefficients",
        evidence(effect("a", 20.0, 1.1, misfit=SMALL.misfit - 14.0), base=replace(SMALL, strain=15.0)),
        V.EFFECT,
        (R.ONE_EXPLANATION,),
        ("a",),
    ),
    Row("a score that Occam's factor takes away", evidence(effect("a", -1.0), base=SMALL), V.NO_GAP, (R.BELOW_NULL,)),
    Row("one effect", evidence(effect("a")), V.EFFECT, (R.ONE_EXPLANATION,), ("a",), remainder=0.0),
    Row("the better of two", evidence(effect("a", 1000.0), effect("b", 1030.0)), V.EFFECT, (R.ONE_EXPLANATION,), ("b",)),
    Row(
        "two that cannot be told apart",
        evidence(effect("a", 999.0), effect("b", 1000.0)),
        V.AMBIGUOUS,
        (R.SEVERAL_EXPLANATIONS,),
        ("b", "a"),
    ),
    Row("effect or coefficients", evidence(effect("a"), coefficients(999.0)), V.AMBIGUOUS, (R.SEVERAL_EXPLANATIONS,), ("a", "")),
    Row(
        "an effect, or a coefficient many tolerances away",
        evidence(effect("a"), coefficients(1010.0, farthest=9.0)),
        V.EFFECT,
        (R.ONE_EXPLANATION,),
        ("a",),
    ),
    Row(
        "a coefficient many tolerances away, and an effect that explains less",
        evidence(effect("a", 900.0, left=1.3), coefficients(1010.0, farthest=9.0)),
        V.PARAMETERS,
        (R.COEFFICIENTS_BEYOND_TOLERANCE,),
        ("",),
    ),
    Row(
        "one that is not sure among many improbable ones",
        evidence(effect("a", 1000.0), *(effect(name, 987.0) for name in "bcdefg")),
        V.EFFECT,
        (R.NO_OTHER_EXPLANATION,),
        ("a",),
    ),
    Row(
        "one effect by two of its variants",
        evidence(effect("a", 1000.0), effect("a", 1000.0), effect("b", 990.0)),
        V.EFFECT,
        (R.ONE_EXPLANATION,),
        ("a",),
    ),
    Row("coefficients", evidence(coefficients()), V.PARAMETERS, (R.COEFFICIENTS_BEYOND_TOLERANCE,), ("",)),
    Row("coefficients under the margin", evidence(coefficients(3.0), base=SMALL), V.NO_GAP, (R.BELOW_NULL,)),
    Row("two effects at once", evidence(effect("a+b")), V.EFFECT, (R.ONE_EXPLANATION,), ("a+b",)),
    Row(
        "a second effect that adds nothing",
        evidence(effect("a+b", 1010.0, misfit=1e4 - 12.0), effect("a", 1000.0, misfit=1e4)),
        V.EFFECT,
        (R.ONE_EXPLANATION,),
        ("a",),
    ),
    Row(
        "a second effect that adds less than its share",
        evidence(effect("a+b", 2000.0, misfit=1e4 - 1900.0), effect("a", 1000.0, misfit=1e4)),
        V.EFFECT,
        (R.ONE_EXPLANATION,),
        ("a",),
    ),
    Row(
        "a second effect that relieves the coefficients, though it adds little",
        evidence(effect("a+b", 2000.0, misfit=1e4 - 1900.0), effect("a", 1000.0, misfit=1e4, strain=40.0)),
        V.EFFECT,
        (R.ONE_EXPLANATION,),
        ("a+b",),
    ),
    Row("three effects at once", evidence(effect("a+b+c")), V.UNKNOWN, (R.TOO_MANY_EFFECTS,), ("a+b+c",), remainder=0.0),
    Row("an effect that leaves a tenth", evidence(effect("a", left=11.0)), V.UNKNOWN, (R.ENERGY_LEFT,), ("a",), remainder=0.1),
    Row(
        "three effects that leave a tenth",
        evidence(effect("a+b+c", left=11.0)),
        V.UNKNOWN,
        (R.ENERGY_LEFT, R.TOO_MANY_EFFECTS),
        ("a+b+c",),
        remainder=0.1,
    ),
    Row(
        "an effect that leaves a twentieth", evidence(effect("a", left=6.0)), V.EFFECT, (R.ONE_EXPLANATION,), ("a",), remainder=0.05
    ),
    Row("a gap that nothing explains", evidence(), V.UNKNOWN, (R.ENERGY_LEFT,), ("",), remainder=1.0),
    Row("a gap under the practical size", evidence(floor=10.1), V.NO_GAP, (R.BELOW_NULL,), remainder=0.0),
    Row("a gap that the model states of itself", evidence(stated=95.0), V.NO_GAP, (R.BELOW_NULL,), remainder=0.0),
    Row(
        "an effect smaller than the error that the model states",
        evidence(effect("a", left=60.0), stated=95.0),
        V.NO_GAP,
        (R.BELOW_PRACTICAL_SIZE,),
    ),
    Row(
        "play repeats values by itself",
        evidence(effect("backlash"), record=(replace(PLAIN, repeated=0.1, repeated_rms=0.3),), repeating=frozenset({"backlash"})),
        V.EFFECT,
        (R.ONE_EXPLANATION,),
        ("backlash",),
    ),
    Row(
        "coefficients beside clean records, where one known effect does the same",
        evidence(effect("a"), coefficients(1010.0), whitened=True),
        V.EFFECT,
        (R.ONE_EXPLANATION,),
        ("a",),
    ),
    Row(
        "half of what exceeds the own error of the clean records",
        evidence(effect("a", left=51.0), base=UNRELATED, whitened=True),
        V.UNKNOWN,
        (R.ENERGY_LEFT,),
        ("",),
    ),
    Row(
        "a single sample that is all of the excess noise",
        evidence(base=replace(SMALL, residual=replace(QUIET, white=(2.0,), outliers=(1,), outliers_rms=(1.7,)))),
        V.UNKNOWN,
        (R.ENERGY_LEFT, R.OUTLIERS),
    ),
    Row(
        "a score that is six nats behind, where the own error's spectrum is known",
        evidence(effect("a"), effect("b", 994.0), whitened=True),
        V.EFFECT,
        (R.ONE_EXPLANATION,),
        ("a",),
    ),
    Row(
        "held samples",
        evidence(base=SMALL, record=(replace(PLAIN, repeated=0.1, repeated_rms=0.3),)),
        V.EFFECT,
        (R.RECORD_CHECK,),
        checks=(C.REPEATED_VALUES,),
    ),
    Row(
        "a measurement that comes back to one value",
        evidence(effect("a"), record=(replace(PLAIN, repeated=0.1, stuck=5),)),
        V.UNKNOWN,
        (R.DISTORTION_LEVEL,),
        ("a",),
    ),
    Row(
        "a measurement that comes back to one value as in clean records",
        evidence(effect("a"), record=(replace(PLAIN, stuck=5, usual_stuck=4),)),
        V.EFFECT,
        (R.ONE_EXPLANATION,),
        ("a",),
    ),
    Row(
        "stretches on one value that play explains",
        evidence(effect("play"), record=(replace(PLAIN, repeated=0.1, stuck=5),), repeating=frozenset({"play"})),
        V.EFFECT,
        (R.ONE_EXPLANATION,),
        ("play",),
    ),
    Row(
        "a lattice beside coefficients that are off",
        evidence(coefficients(), record=(replace(PLAIN, step=1.0),)),
        V.EFFECT,
        (R.RECORD_CHECK,),
        ("",),
        (C.VALUE_LATTICE,),
    ),
    Row(
        "a lattice beside two effects that cannot be told apart",
        evidence(effect("a"), effect("b"), record=(replace(PLAIN, step=1.0),)),
        V.AMBIGUOUS,
        (R.SEVERAL_EXPLANATIONS,),
        ("a", "b"),
        (C.VALUE_LATTICE,),
    ),
    Row(
        "more white noise than stated",
        evidence(base=replace(SMALL, residual=replace(QUIET, white=(2.0,)))),
        V.EFFECT,
        (R.RECORD_CHECK,),
        checks=(C.WHITE_SPECTRUM,),
    ),
    Row(
        "more white noise than stated, a trifle beside the model's own error",
        evidence(base=replace(SMALL, residual=replace(QUIET, white=(2.0,))), stated=1000.0, weight=0.001),
        V.NO_GAP,
        (R.BELOW_NULL,),
    ),
    Row(
        "an effect that stays within the model's own error at each of its frequencies",
        evidence(replace(effect("a"), local=2.9), base=none(energy=0.9, residual=QUIET), whitened=True),
        V.NO_GAP,
        (R.BELOW_PRACTICAL_SIZE,),
    ),
    Row(
        "an effect that exceeds the model's own error at its frequencies",
        evidence(replace(effect("a"), local=3.1), whitened=True),
        V.EFFECT,
        (R.ONE_EXPLANATION,),
        ("a",),
    ),
    Row(
        "more white noise than stated, where none is",
        evidence(base=replace(SMALL, residual=replace(QUIET, white=(2.0,))), stated_noise=(0.0,)),
        V.NO_GAP,
        (R.BELOW_NULL,),
    ),
    Row(
        "more white noise than stated, which held samples bring",
        evidence(base=replace(SMALL, residual=replace(QUIET, white=(2.0,))), record=(replace(PLAIN, repeated=0.1),)),
        V.EFFECT,
        (R.RECORD_CHECK,),
        checks=(C.REPEATED_VALUES,),
    ),
    Row(
        "more white noise than stated, an effect withheld",
        evidence(base=replace(SMALL, residual=replace(QUIET, white=(2.0,))), checks=ALL - {C.WHITE_SPECTRUM}),
        V.NO_GAP,
        (R.BELOW_NULL,),
    ),
    Row("outliers", evidence(base=OUTLIERS_BASE), V.UNKNOWN, (R.ENERGY_LEFT, R.OUTLIERS), remainder=1.0),
    Row(
        "outliers that are a small part of the gap",
        evidence(effect("a", residual=SPIKES)),
        V.EFFECT,
        (R.ONE_EXPLANATION,),
        ("a",),
        remainder=1.7**2 / 100.0,
    ),
    Row(
        "outliers beside effects that cannot be told apart",
        evidence(effect("a", residual=SPIKES), effect("b", residual=SPIKES), base=none(energy=5.0)),
        V.UNKNOWN,
        (R.ENERGY_LEFT, R.OUTLIERS),
        ("a", "b"),
        remainder=1.7**2 / 4.0,
    ),
    Row(
        "too many outliers for outliers",
        evidence(base=replace(SMALL, residual=replace(SPIKES, outliers=(5000,)))),
        V.EFFECT,
        (R.RECORD_CHECK,),
        checks=(C.WHITE_SPECTRUM,),
    ),
    Row(
        "a second effect that takes off little of what the model leaves on clean records of other commands",
        evidence(effect("a", left=4.0), effect("a+b", 1010.0), whitened=True),
        V.EFFECT,
        (R.ONE_EXPLANATION,),
        ("a",),
    ),
    Row(
        "the same beside a clean record of the same command, whose error is in no residual",
        evidence(effect("a", left=4.0), effect("a+b", 1010.0), whitened=True, carried=True),
        V.EFFECT,
        (R.ONE_EXPLANATION,),
        ("a+b",),
    ),
    Row(
        "1/f noise alone",
        evidence(base=none(residual=FALLING)),
        V.EFFECT,
        (R.RECORD_CHECK, R.NOISE_EXPLAINS_MORE),
        checks=(C.FALLING_SPECTRUM,),
        remainder=0.0,
    ),
    Row(
        "1/f noise no larger than a single clean record's own may be",
        evidence(base=none(residual=replace(QUIET, flicker=flicker(1e7, 1.5))), clean_noise=True),
        V.NO_GAP,
        (R.BELOW_NULL,),
    ),
    Row(
        "1/f noise larger than that",
        evidence(base=none(residual=replace(QUIET, flicker=flicker(1e7, 2.5))), clean_noise=True),
        V.EFFECT,
        (R.RECORD_CHECK, R.NOISE_EXPLAINS_MORE),
        checks=(C.FALLING_SPECTRUM,),
    ),
    Row(
        "a falling spectrum of another shape",
        evidence(base=none(residual=replace(FALLING, flicker=flicker(1e7, plausible=False)))),
        V.UNKNOWN,
        (R.ENERGY_LEFT,),
        ("",),
        remainder=0.49,
    ),
    Row(
        "1/f noise that explains more than an effect",
        evidence(effect("a", left=50.0), base=none(residual=FALLING)),
        V.EFFECT,
        (R.RECORD_CHECK, R.NOISE_EXPLAINS_MORE),
        checks=(C.FALLING_SPECTRUM,),
        remainder=0.0,
    ),
    Row(
        "1/f noise that explains more than an effect, beside coefficients",
        evidence(effect("a", left=50.0), coefficients(500.0, left=90.0), base=none(residual=FALLING)),
        V.EFFECT,
        (R.RECORD_CHECK, R.NOISE_EXPLAINS_MORE),
        ("",),
        (C.FALLING_SPECTRUM,),
        remainder=0.0,
    ),
    Row(
        "1/f noise that explains less than an effect and is gone with it",
        evidence(effect("a"), base=none(residual=replace(FALLING, flicker=flicker(100.0)))),
        V.EFFECT,
        (R.ONE_EXPLANATION,),
        ("a",),
    ),
    Row(
        "1/f noise beside an effect",
        evidence(effect("a", residual=replace(QUIET, flicker=flicker(100.0, 0.6)))),
        V.EFFECT,
        (R.ONE_EXPLANATION, R.RECORD_CHECK),
        ("a",),
        (C.FALLING_SPECTRUM,),
    ),
    Row(
        "1/f noise beside an effect that leaves too much",
        evidence(effect("a", left=40.0, residual=replace(QUIET, energy=40.0, flicker=flicker(100.0)))),
        V.UNKNOWN,
        (R.ENERGY_LEFT,),
        ("a",),
        (C.FALLING_SPECTRUM,),
        remainder=0.39,
    ),
    Row(
        "1/f noise too small to name",
        evidence(effect("a", residual=replace(QUIET, flicker=flicker(100.0, 0.4)))),
        V.EFFECT,
        (R.ONE_EXPLANATION,),
        ("a",),
    ),
    Row(
        "noise in excess that falls up to the top of the spectrum, beside a model's own error",
        evidence(base=none(energy=3.0, residual=replace(QUIET, white=(5.0,), flicker=flicker(5.0, top=0.9))), weight=0.001),
        V.EFFECT,
        (R.RECORD_CHECK, R.NOISE_EXPLAINS_MORE),
        checks=(C.FALLING_SPECTRUM,),
    ),
    Row(
        "noise in excess that is flat at the top, beside a model's own error",
        evidence(base=none(energy=3.0, residual=replace(QUIET, white=(5.0,), flicker=flicker(5.0, top=0.01))), weight=0.001),
        V.EFFECT,
        (R.RECORD_CHECK,),
        checks=(C.WHITE_SPECTRUM,),
    ),
    Row(
        "1/f noise that hides how much white noise there is",
        evidence(base=none(residual=replace(FALLING, white=(5.0,), flicker=flicker(1e7, top=0.5)))),
        V.EFFECT,
        (R.RECORD_CHECK, R.NOISE_EXPLAINS_MORE),
        checks=(C.FALLING_SPECTRUM,),
    ),
)


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
    assert {reason for row in TABLE for reason in row.reasons} == set(Reason)
    assert {row.verdict for row in TABLE} == set(Verdict)


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
        (replace(PLAIN, repeated=0.003, step=0.01), ()),
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


@pytest.mark.parametrize("row", TABLE, ids=lambda row: row.rule)
def test_the_novelty_score_exceeds_one_half_where_a_rule_says_unknown(row):
    decision = decide(row.evidence, LIMITS)
    assert (decision.novelty > 0.5) == (row.verdict is V.UNKNOWN)


def test_cases_short_of_every_threshold_are_in_order():
    """The remainder is 0 in both, and the one that leaves more is the newer."""
    little, more = (decide(evidence(effect("a", left=1.0 + left)), LIMITS) for left in (0.02, 0.08))
    assert little.remainder == more.remainder == 0.0
    assert 0.0 < little.novelty < more.novelty < 0.5


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


def drifting(adds: float, statistic: float = 100.0, variable: str = "time", left: Sequence[DistortionEvidence] = ()) -> Evidence:
    """An effect that changes with time, and the same with a drift, which takes `adds` of the noise's energy off besides."""
    tested = replace(QUIET, energy=2.0 - adds, distortions=tuple(left))
    return evidence(
        replace(changing(0.8, statistic, variable=variable), misfit=0.5 * SAMPLES * 2.0, energy=2.0),
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


def test_of_realizations_that_are_alike_only_the_best_counts():
    """Eight holds of one command as good as one delay: the hold is no likelier for being told in eight ways."""
    found = decide(evidence(effect("delay"), *(effect("dac_hold", 999.99) for _ in range(8))), LIMITS)
    assert found.probability[("delay",)] > found.probability[("dac_hold",)]
