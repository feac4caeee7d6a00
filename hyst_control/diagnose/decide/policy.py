# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Policy of the diagnosis: from evidence to a verdict with its reasons. Pure functions of numbers; nobody edits their answer.

`decide` judges one problem, `join` the axes of a plant. A hypothesis is a claim where it beats the simulated null and takes off more
than the practical size; claims become probabilities by their scores. The verdict is the first of these whose rule holds:

    unknown      the best explanation leaves too much, needs too many effects, one at the end of its range, the measurement stays
                 on one value, or much of the gap is unexplained beside effects, or explained by coefficients far away
    ambiguous    the data cannot separate several explanations
    effect       one explanation by effects, or where coefficients are none what a check of the record found
    parameters   the coefficients explain it, further off than their tolerance, or within it where that moves the simulation far
    no_gap       none of these
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.diagnose.configuration import Thresholds
from hyst_control.diagnose.decide import novelty
from hyst_control.diagnose.decide.novelty import leaves_more, remainder, unexplained
from hyst_control.diagnose.decide.record_findings import findings, flicker_found, outweighs, residual_of, share_of_outliers
from hyst_control.diagnose.decide.vibration_finding import vibration, vibration_found, without_vibration
from hyst_control.diagnose.evidence import CompanionEvidence, Evidence, HypothesisEvidence
from hyst_control.diagnose.verdict import Decision, JointDecision, Reason, Verdict

PARAMETERS = ("parameters",)  # Key of the coefficients alone in `Decision.probability`


def join(decisions: Sequence[Decision]) -> JointDecision:
    """Join the decisions on the axes of a plant."""
    prevailing = min((decision.verdict for decision in decisions), key=list(Verdict).index)
    reasons = {reason for decision in decisions if decision.verdict is prevailing for reason in decision.reasons}
    return JointDecision(
        prevailing,
        _ordered(reasons),
        max(decision.remainder for decision in decisions),
        max(decision.unexplained for decision in decisions),
        max(decision.novelty for decision in decisions),
    )


def decide(evidence: Evidence, thresholds: Thresholds) -> Decision:
    """Judge the evidence on one problem."""
    claims = _claims(evidence, thresholds)
    noise = flicker_found(evidence, _first(claims), thresholds)
    outweighed = noise is not None and outweighs(noise, evidence, _first(claims))
    shaken = None
    if noise is None:
        shaken = vibration_found(evidence, _first(claims), remainder(evidence, _first(claims), thresholds), thresholds)
    if outweighed or shaken == 0:
        claims = _claims(evidence, thresholds, with_effects=False)
    chosen = _first(claims)
    probability = _probabilities(evidence, claims, thresholds)
    shown, outliers = findings(evidence, chosen, noise, thresholds)
    if shaken is not None:
        hump = residual_of(evidence, shaken).hump
        assert hump is not None
        shown = (*shown, vibration(hump, evidence.noise[0]))
        evidence = without_vibration(evidence, thresholds)
    left = 0.0 if outweighed else remainder(evidence, chosen, thresholds)
    unaccounted = max([left, *(share_of_outliers(evidence, one) for one in outliers)])
    companions = tuple(one for one in residual_of(evidence, chosen).companions if is_unusual(one, evidence, thresholds))

    signs = novelty.signs(evidence, chosen, outweighed, outliers, thresholds)
    # Fits count with rounding, held samples and white noise. Only noise that they take for white moves coefficients.
    correlated = noise is not None or shaken is not None
    unknown = {reason for reason, sign in signs.items() if sign > thresholds.novelty_threshold}
    # What leaves much, needs too much or is not itself stands alone: others that are as probable fail as well.
    alone = unknown - {Reason.UNEXPLAINED_SHARE, Reason.OUTLIERS}
    listed = (chosen,) if alone else _listed(evidence, claims, probability, thresholds)
    effects = any(evidence.hypotheses[index].names for index in listed)
    at_bound = len(listed) == 1 and evidence.hypotheses[chosen].at_bound
    reasons: set[Reason] = set()
    if unknown or at_bound:
        verdict = Verdict.UNKNOWN
        reasons = unknown | ({Reason.AT_BOUND} if at_bound else set())
        if unknown & {Reason.ENERGY_LEFT, Reason.OUTLIERS}:  # energy left says all that the share says
            reasons = (reasons | {Reason.ENERGY_LEFT}) - {Reason.UNEXPLAINED_SHARE}
            reasons -= {Reason.OUTLIERS} if unaccounted <= left else set()
    elif len(listed) > 1:
        verdict, reasons = Verdict.AMBIGUOUS, {Reason.SEVERAL_EXPLANATIONS}
    elif effects or (shown and (correlated or not listed)) or (companions and not listed):
        verdict = Verdict.EFFECT
        if companions:
            reasons |= {Reason.SESSION_DIFFERS}
        if effects:
            sure = probability[key(evidence.hypotheses[chosen])] >= thresholds.sure_probability
            reasons |= {Reason.ONE_EXPLANATION if sure else Reason.NO_OTHER_EXPLANATION}
        if shown:
            reasons |= {Reason.RECORD_CHECK} | ({Reason.NOISE_EXPLAINS_MORE} if outweighed or shaken == 0 else set())
    elif listed:
        verdict, reasons = Verdict.PARAMETERS, {Reason.COEFFICIENTS_BEYOND_TOLERANCE}
    elif evidence.moved > thresholds.moved_share:
        verdict, reasons = Verdict.PARAMETERS, {Reason.COEFFICIENTS_WITHIN_TOLERANCE}
    else:
        beyond = any(_beats_null(one, evidence, thresholds) for one in evidence.hypotheses)
        verdict, reasons = Verdict.NO_GAP, {Reason.BELOW_PRACTICAL_SIZE if beyond else Reason.BELOW_NULL}
    return Decision(
        verdict,
        _ordered(reasons),
        chosen,
        listed,
        probability,
        unaccounted,
        shown,
        outliers,
        companions,
        tuple(axis for axis, sign in novelty.stands(evidence, chosen, thresholds) if sign > thresholds.novelty_threshold),
        max(unaccounted, unexplained(evidence, chosen, thresholds)),
        novelty.score(evidence, chosen, signs, at_bound, thresholds),
    )


def contenders(evidence: Evidence, thresholds: Thresholds) -> tuple[int, ...]:
    """Hypotheses whose residuals the policy may ask for: no effect, the best explanation, and the best one without effects."""
    first = _first(_claims(evidence, thresholds))
    return tuple(sorted({0, first, _first(_claims(evidence, thresholds, with_effects=False))}))


def practical_floor(
    spans: Annotated[Array, "A"],
    steps: Annotated[Array, "A"],
    stated: Annotated[Array, "A"],
    noise: Annotated[Array, "A"],
    thresholds: Thresholds,
) -> float:
    """Rms, in units of the noise, that an effect must take off to be worth naming."""
    # Noise stated beyond the measured one is how far the model was off; rounding follows the signal: a share of it is no effect.
    size = thresholds.practical_size * spans / noise
    excess = np.sqrt(np.maximum((stated / noise) ** 2 - 1.0, 0.0))
    rounded = steps / np.sqrt(12.0) / noise
    return float(np.sqrt(np.mean(size**2 + (thresholds.stated_excess * excess) ** 2 + (thresholds.rounding_share * rounded) ** 2)))


def strained(strain: float, coefficients: int, thresholds: Thresholds) -> bool:
    """True when coefficients are further from the nominal ones than chance explains."""
    return 2.0 * strain >= coefficients + thresholds.strain_deviations * float(np.sqrt(2.0 * coefficients))


def exceeds(without: HypothesisEvidence, one: HypothesisEvidence, evidence: Evidence, thresholds: Thresholds) -> bool:
    """True where a hypothesis is better than another by more than chance."""
    return evidence.temper * (without.misfit - one.misfit) > evidence.null + thresholds.margin


def key(hypothesis: HypothesisEvidence) -> tuple[str, ...]:
    """Name of a hypothesis in `Decision.probability`."""
    return PARAMETERS if hypothesis.coefficients_alone else hypothesis.names


def _claims(evidence: Evidence, thresholds: Thresholds, with_effects: bool = True) -> tuple[int, ...]:
    """Hypotheses that claim to explain the gap, best first."""
    found = [
        index
        for index, one in enumerate(evidence.hypotheses)
        if (one.names and with_effects or one.coefficients_alone)
        and _beats_null(one, evidence, thresholds)
        and _worth_naming(one, evidence, thresholds)
    ]
    found.sort(key=lambda index: -evidence.hypotheses[index].score)
    return tuple(
        index
        for index in found
        if not _adds_too_little(index, evidence, thresholds)
        and not _is_known_effect(index, found, evidence, thresholds)
        and not _has_plainer_one(index, found, evidence, thresholds)
    )


def _first(claims: Sequence[int]) -> int:
    """The best claim, or "no effect" where there is none."""
    return claims[0] if claims else 0


def _beats_null(one: HypothesisEvidence, evidence: Evidence, thresholds: Thresholds) -> bool:
    if one.coefficients_alone:
        return one.score > thresholds.margin
    return bool(one.names) and one.score > 0 and exceeds(evidence.hypotheses[0], one, evidence, thresholds)


def _worth_naming(one: HypothesisEvidence, evidence: Evidence, thresholds: Thresholds) -> bool:
    """It takes off more than the practical size, or relieves coefficients that had to leave their tolerance for it."""
    # A model that states an error of its own leaves all kinds of it: an effect has to take off what goes beyond, unless the weight of
    # the samples has that error in it already. A line is looked for where it stands out of the frequencies around, with that error there.
    unweighted = evidence.weight == 1.0
    hidden = unweighted and not (one.names and evidence.lines.issuperset(one.names))
    least = max(evidence.floor**2, thresholds.own_error_share * (evidence.stated - 1.0) if hidden else 0.0)
    before = evidence.hypotheses[0].energy
    # Coefficients can fit any residual: beside a known model discrepancy they explain only a gap that exceeds it.
    if one.coefficients_alone and _has_own_error(evidence) and before <= evidence.stated:
        return False
    # What leaves no more than the model leaves on baseline records is no gap.
    reduction = before - one.energy if one.reduction is None else one.reduction
    if reduction > least and (unweighted or before > evidence.stated):
        return True
    if unweighted and evidence.stated >= thresholds.own_error_energy:
        return False
    relief = evidence.temper * (evidence.hypotheses[0].strain - one.strain)
    return (unweighted and one.coefficients_alone) or relief > evidence.null + thresholds.margin


def _has_own_error(evidence: Evidence) -> bool:
    """True where what is left has the model discrepancy in it, whose spectrum is known; beside the same command it is carried over."""
    return evidence.whitened and not evidence.carried


def _is_known_effect(index: int, claims: Sequence[int], evidence: Evidence, thresholds: Thresholds) -> bool:
    """True where one known effect does, with coefficients within their tolerances, what coefficients alone do many tolerances away."""
    one = evidence.hypotheses[index]
    # Beside baseline records the coefficients are those of these records, and what has changed is an effect if a known one does it.
    if not one.coefficients_alone or (one.farthest < thresholds.many_tolerances and not evidence.whitened):
        return False
    size = 0.5 * evidence.temper * evidence.weight * evidence.rows * len(evidence.noise)  # nats of a noise energy
    taken_off = size * (evidence.hypotheses[0].energy - one.energy)
    return any(
        len(other.names) == 1
        and (
            not exceeds(other, one, evidence, thresholds)
            if _has_own_error(evidence)
            else one.score - other.score <= thresholds.added_share * taken_off  # a stage may differ from the physics by as much
        )
        and not strained(other.strain, evidence.coefficients, thresholds)
        for other in (evidence.hypotheses[i] for i in claims)
    )


def _adds_too_little(index: int, evidence: Evidence, thresholds: Thresholds) -> bool:
    """True where a combination exceeds one of its parts by less than a claim needs, or by less than a share of all that it takes off."""
    # A part that was dropped, as it does not hold, so takes its combinations with it.
    one = evidence.hypotheses[index]
    if len(one.names) < 2:
        return False
    parts = [other for other in evidence.hypotheses if other.names and set(other.names) < set(one.names)]
    if not parts:
        return False
    best = min(parts, key=lambda part: part.misfit)
    small = best.misfit - one.misfit <= thresholds.added_share * (evidence.hypotheses[0].misfit - one.misfit)
    # The share does not count where the coefficients had to leave their tolerance for a part, and need not for the combination.
    best_strained, one_strained = (strained(each.strain, evidence.coefficients, thresholds) for each in (best, one))
    relieved = best_strained and not one_strained
    return not exceeds(best, one, evidence, thresholds) or (small and not relieved)


def _has_plainer_one(index: int, claims: Sequence[int], evidence: Evidence, thresholds: Thresholds) -> bool:
    """True where a simpler effect leaves hardly more than noise, though a hypothesis with another one fits a very little better."""
    one = evidence.hypotheses[index]
    plainer = [{plain, *one.names} - {name} for name, plain in evidence.plainer if name in one.names]
    most = one.misfit + thresholds.added_share * (evidence.hypotheses[0].misfit - one.misfit)
    return any(
        set(other.names) in plainer
        and not leaves_more(evidence, other, thresholds)
        and other.misfit <= most
        and 1.0 / (1.0 + np.exp(min(thresholds.sharpness * (other.score - one.score), 0.0))) >= thresholds.sure_probability
        for other in (evidence.hypotheses[i] for i in claims)
    )


def _probabilities(evidence: Evidence, claims: Sequence[int], thresholds: Thresholds) -> dict[tuple[str, ...], float]:
    hypotheses = [evidence.hypotheses[index] for index in claims or (0,)]
    # Of an effect's realizations the best one counts: several that are alike make the effect no likelier.
    best: dict[tuple[str, ...], float] = {}
    for one in hypotheses:
        best[key(one)] = max(best.get(key(one), -np.inf), one.score)
    weights = np.exp(thresholds.sharpness * (np.array(list(best.values())) - max(best.values())))
    return dict(zip(best, (weights / weights.sum()).tolist(), strict=True))


def _listed(
    evidence: Evidence, claims: Sequence[int], probability: Mapping[tuple[str, ...], float], thresholds: Thresholds
) -> tuple[int, ...]:
    """Explanations to be named: one that is sure alone, else all that are probable, but none that becomes the first one (`ends_as`)."""
    if not claims:
        return ()
    chosen = key(evidence.hypotheses[claims[0]])
    first = probability[chosen]
    if first >= thresholds.sure_probability:
        return (claims[0],)
    best: dict[tuple[str, ...], int] = {}
    for index in claims:
        best.setdefault(key(evidence.hypotheses[index]), index)
    least = min(thresholds.listed_probability, first)  # of very many the best is named, though improbable
    simpler = dict(evidence.ends_as)
    same = {name for name in best if name != chosen and sorted(simpler.get(effect, effect) for effect in name) == sorted(chosen)}
    return tuple(index for name, index in best.items() if probability[name] >= least and name not in same)


def is_unusual(companion: CompanionEvidence, evidence: Evidence, thresholds: Thresholds) -> bool:
    """True where zero or drift of a session exceed chance, the practical size, and what baseline records show."""
    if np.isnan(companion.usual):
        return False  # nothing says what is usual
    least = max(thresholds.companion_deviations * companion.deviation, companion.usual)
    return companion.rms > evidence.floor * evidence.noise[companion.axis] and abs(companion.value) > least


def _ordered(reasons: Collection[Reason]) -> tuple[Reason, ...]:
    return tuple(reason for reason in Reason if reason in reasons)
