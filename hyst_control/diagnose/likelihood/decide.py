# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""From the weights of the hypotheses to a verdict: no gap, something else, or the smallest set of explanations of a given probability."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hyst_control.diagnose.decide.policy import PARAMETERS
from hyst_control.diagnose.likelihood.fits import Fits
from hyst_control.diagnose.likelihood.hypotheses import FLICKER, Kind, Weighed
from hyst_control.diagnose.verdict import Reason, Verdict
from hyst_control.effects import ending_as, shares_elsewhere


@dataclass(frozen=True)
class Judgement:
    """Verdict on one problem, and the hypotheses behind it."""

    verdict: Verdict
    reasons: tuple[Reason, ...]
    named: tuple[Weighed, ...]  # Explanations that are listed, the most probable first; of an unknown gap the nearest one
    probability: dict[tuple[str, ...], float]  # By the names of an explanation
    nothing: float  # Probability of no gap that matters
    something_else: float  # Probability of something else


def judge(weighed: Sequence[Weighed], fits: Fits, floor: float, level: float, alarm: float) -> Judgement:
    """Judge the weights of hypotheses."""
    # floor: rms that matters, in units of noise and discrepancy; level: probability of the set that is named; alarm: a gap is named
    # only if "no gap" is less probable than this
    nothing = sum(one.probability for one in weighed if not _matters(one, fits, floor))
    other = sum(one.probability for one in weighed if one.kind is Kind.SOMETHING_ELSE and _matters(one, fits, floor))
    known = [one for one in weighed if one.kind in (Kind.EFFECTS, Kind.PARAMETERS) and _matters(one, fits, floor)]
    total = sum(one.probability for one in known)
    probability = {PARAMETERS if one.kind is Kind.PARAMETERS else one.names: one.probability for one in known}

    def judgement(verdict: Verdict, reason: Reason, named: Sequence[Weighed]) -> Judgement:
        return Judgement(verdict, (reason,), tuple(named), probability, nothing, other)

    if nothing >= min(alarm, max(other, total)):
        small = weighed[0].kind is not Kind.NOTHING and not _matters(weighed[0], fits, floor)
        return judgement(Verdict.NO_GAP, Reason.BELOW_PRACTICAL_SIZE if small else Reason.BELOW_NULL, ())
    if other > total or not known:
        return judgement(Verdict.UNKNOWN, Reason.SOMETHING_ELSE, known[:1])
    shares = np.cumsum([one.probability for one in known]) / total
    named = list[Weighed]()
    for one in known[: int(np.searchsorted(shares, level)) + 1]:
        plain = next((other for other in named if _is_richer(one, other)), None)
        if plain is None:
            named.append(one)
        else:
            probability[plain.names] += probability.pop(one.names)
    if len(named) > 1:
        return judgement(Verdict.AMBIGUOUS, Reason.SEVERAL_EXPLANATIONS, named)
    if named[0].kind is Kind.PARAMETERS:
        return judgement(Verdict.PARAMETERS, Reason.COEFFICIENTS_BEYOND_TOLERANCE, named)
    noise = named[0].names == (FLICKER,)
    return judgement(Verdict.EFFECT, Reason.NOISE_EXPLAINS_MORE if noise else Reason.ONE_EXPLANATION, named)


def _is_richer(one: Weighed, other: Weighed) -> bool:
    """True for an explanation that has an effect where the other has a simpler one, which it may stand for."""
    pairs = (*ending_as(), *shares_elsewhere())
    return any({*one.names} - {rich} | {plain} == {*other.names} for rich, plain in pairs if rich in one.names)


def _matters(one: Weighed, fits: Fits, floor: float) -> bool:
    """True for a hypothesis other than nothing whose effects are large enough to matter, by what they change or take off."""
    if one.kind is Kind.NOTHING:
        return False
    if one.flicker or (one.kind is Kind.SOMETHING_ELSE and not one.names):
        return True
    return max(one.hypothesis.reduction, float(np.sqrt(one.hypothesis.change.sum() / fits.octaves.sizes.sum()))) > floor
