# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Rules of the policy on what was fitted: effects, coefficients, a session's zero, changes of an effect, and what is left."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from test.diagnose.made_evidence import (
    MISFIT,
    NULL,
    QUIET,
    SAMPLES,
    SMALL,
    UNRELATED,
    changing,
    coefficients,
    effect,
    evidence,
    none,
    session,
)
from test.diagnose.policy_rows import R, Row, V

CHANGING_PAIR = replace(effect("a+b"), residual=replace(changing(0.8).residual, energy=1.5))
"""Two effects of which the size of one would have to change with the level."""
SLIGHT = none(energy=0.68, misfit=0.5 * SAMPLES * 0.68, beyond=30.0, residual=replace(QUIET, energy=0.68))
"""Less than the own error and the noise, all frequencies together, but not at each."""

FEW_LINES = replace(
    effect("a", 50.0, left=0.67), misfit=SLIGHT.misfit - 57.0, beyond=0.0, residual=replace(QUIET, energy=0.67, predictable=1.0)
)
"""Takes off what exceeds them."""


ROWS = (
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
        "an effect that leaves twice the own error that the model states",
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
    Row("an effect that explains a tenth of the gap", evidence(effect("a", left=92.0)), V.UNKNOWN, (R.ENERGY_LEFT,), ("a",)),
    Row("an effect that changes with the level", evidence(changing(-0.8)), V.UNKNOWN, (R.DISTORTION_LEVEL,), ("a",)),
    Row("an effect that changes with time", evidence(changing(0.8, variable="time")), V.UNKNOWN, (R.DISTORTION_TIME,), ("a",)),
    Row("an effect that changes with the rate", evidence(changing(0.8, variable="rate")), V.UNKNOWN, (R.DISTORTION_RATE,), ("a",)),
    Row("an effect of one direction", evidence(changing(2.0, variable="branch")), V.UNKNOWN, (R.DISTORTION_BRANCH,), ("a",)),
    Row("a change within the model discrepancy", evidence(changing(0.8, left=1.05)), V.EFFECT, (R.ONE_EXPLANATION,), ("a",)),
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
    Row(
        "coefficients within their tolerance that move the simulation far",
        evidence(coefficients(3.0), base=SMALL, moved=0.031),
        V.PARAMETERS,
        (R.COEFFICIENTS_WITHIN_TOLERANCE,),
    ),
    Row("coefficients that move it little", evidence(coefficients(3.0), base=SMALL, moved=0.029), V.NO_GAP, (R.BELOW_NULL,)),
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
    Row(
        "three effects at once, one of them alone on an axis",
        evidence(effect("a+b+b", axes=(1, 1, 0))),
        V.EFFECT,
        (R.ONE_EXPLANATION,),
        ("a+b+b",),
    ),
    Row(
        "two on an axis and one on all", evidence(effect("a+b+c", axes=(1, 1, None))), V.UNKNOWN, (R.TOO_MANY_EFFECTS,), ("a+b+c",)
    ),
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
        ("a",),
    ),
    Row(
        "coefficients beside no more than the usual error",
        evidence(coefficients(left=0.7, strain=5.0, local=9.0), base=none(energy=0.9, strain=300.0, residual=QUIET), whitened=True),
        V.NO_GAP,
        (R.BELOW_PRACTICAL_SIZE,),
        (),
    ),
    Row(
        "coefficients beside more than the usual error",
        evidence(coefficients(left=1.0, strain=5.0, local=9.0), base=none(energy=1.5, strain=300.0), whitened=True),
        V.PARAMETERS,
        (R.COEFFICIENTS_BEYOND_TOLERANCE,),
        ("",),
    ),
    Row(
        "an effect that stays within the model discrepancy at each of its frequencies",
        evidence(replace(effect("a"), local=2.9), base=none(energy=0.9, residual=QUIET), whitened=True),
        V.NO_GAP,
        (R.BELOW_PRACTICAL_SIZE,),
    ),
    Row(
        "an effect without which coefficients leave their tolerances, though with them nothing exceeds the model discrepancy",
        evidence(
            replace(effect("a"), local=2.9, beyond=0.0, strain=2.0), base=none(energy=0.9, beyond=0.0, strain=500.0), whitened=True
        ),
        V.EFFECT,
        (R.ONE_EXPLANATION,),
        ("a",),
    ),
    Row(
        "an effect at many frequencies, at each of which it stays within the model discrepancy",
        evidence(replace(FEW_LINES, local=2.9), base=SLIGHT, whitened=True),
        V.NO_GAP,
        (R.BELOW_PRACTICAL_SIZE,),
    ),
    Row(
        "a second effect that only takes off what stays under the model discrepancy",
        evidence(replace(effect("a", left=4.0), beyond=0.0), effect("a+b", 5000.0, beyond=0.0), whitened=True, stated=4.0),
        V.EFFECT,
        (R.ONE_EXPLANATION,),
        ("a",),
    ),
    Row(
        "coefficients far away that take up next to nothing beside a great gap",
        evidence(effect("a", farthest=40.0, taken_up=0.5)),
        V.EFFECT,
        (R.ONE_EXPLANATION,),
        ("a",),
    ),
    Row(
        "coefficients far away that take up a good part of it",
        evidence(effect("a", farthest=40.0, taken_up=50.0)),
        V.UNKNOWN,
        (R.UNEXPLAINED_SHARE,),
        ("a",),
    ),
    Row(
        "the same of a part that leaves a tenth of the gap",
        evidence(effect("a", 900.0, left=11.0), CHANGING_PAIR),
        V.UNKNOWN,
        (R.DISTORTION_LEVEL,),
        ("a+b",),
    ),
    Row(
        "an effect that exceeds the model discrepancy at its frequencies",
        evidence(replace(effect("a"), local=3.1), whitened=True),
        V.EFFECT,
        (R.ONE_EXPLANATION,),
        ("a",),
    ),
    Row(
        "a second effect that takes off little beside a clean record of the same command, whose error is in no residual",
        evidence(effect("a", left=4.0), effect("a+b", 1010.0), whitened=True, carried=True),
        V.EFFECT,
        (R.ONE_EXPLANATION,),
        ("a+b",),
    ),
)
