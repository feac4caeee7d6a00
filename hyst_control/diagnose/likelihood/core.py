# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Diagnosis of one problem by the likelihood core, in the form that reports are made of."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from hyst_control.diagnose.configuration import Configuration
from hyst_control.diagnose.decide.policy import is_unusual
from hyst_control.diagnose.decide.record_findings import findings
from hyst_control.diagnose.decide.vibration_finding import vibration, vibration_found
from hyst_control.diagnose.evidence import Evidence
from hyst_control.diagnose.likelihood.conditional import conditioned
from hyst_control.diagnose.likelihood.decide import Judgement, judge
from hyst_control.diagnose.likelihood.fits import Fits, fits_of
from hyst_control.diagnose.likelihood.hypotheses import FLICKER, PRIORS, Kind, Priors, Weighed, weigh
from hyst_control.diagnose.likelihood.structure import structure
from hyst_control.diagnose.model_error.baseline import Baseline, with_discrepancy
from hyst_control.diagnose.problem.problem import Problem
from hyst_control.diagnose.run.collect import collect, companions, residual_evidence
from hyst_control.diagnose.run.prepare import Prepared, prepare
from hyst_control.diagnose.search.beam_search import Found, search
from hyst_control.diagnose.validate.present_in_baseline import CleanRecords
from hyst_control.diagnose.verdict import Decision, Reason, Verdict


def by_likelihood(
    problem: Problem,
    baseline: Baseline | None,
    sensor_side: bool,
    without: Sequence[str],
    progress: Callable[[str], None],
    configuration: Configuration,
) -> tuple[Found, Evidence, Decision, Baseline | None, Mapping[str, float]]:
    """Diagnose one problem by one likelihood of all hypotheses; last, of an unknown gap, the probability of "yes" by question."""
    priors, baseline = PRIORS, _with_spectrum(problem, baseline, configuration)
    prepared = prepare(problem, baseline, without, configuration, progress)
    found, fits, weighed = searched(prepared, sensor_side, progress, configuration, priors)
    if FLICKER in prepared.without:
        weighed = tuple(one for one in weighed if not one.flicker)
    weighed = _changed(weighed, found, prepared.clean, priors)
    judged = judge(weighed, fits, prepared.floor, priors.level, priors.alarm)
    evidence = _with_scores(collect(found, 0.0, prepared, configuration), weighed)
    decision, evidence = _decision(judged, evidence, prepared, baseline, found, configuration)
    asked: Mapping[str, float] = {}
    if decision.verdict is Verdict.UNKNOWN:
        effects = [one for one in weighed if one.kind is Kind.EFFECTS and not one.flicker]
        asked = structure(fits, effects[0] if effects else None, priors)
    return found, evidence, decision, baseline, asked


def searched(
    prepared: Prepared, sensor_side: bool, progress: Callable[[str], None], configuration: Configuration, priors: Priors
) -> tuple[Found, Fits, tuple[Weighed, ...]]:
    """Fit and weigh single effects, and combinations where something else may be more than any of these."""
    members = prepared.members(sensor_side)
    usual, few = configuration.search, priors.parents
    alone = replace(configuration, search=replace(usual, depth=1, depth_with_own_error=1))
    together = replace(configuration, search=replace(usual, beam=few, beam_with_own_error=few, screened=priors.screened))
    for settings in (alone, together):
        found = search(prepared.linearized, members, priors.followed, prepared.floor, prepared.leaves, progress, settings)
        fits = fits_of(found, priors.kept, priors.freedom)
        weighed = weigh(fits, priors)
        other = sum(one.probability for one in weighed if one.kind is Kind.SOMETHING_ELSE)
        if weighed[0].kind is Kind.NOTHING or other < priors.combined:
            break
    return found, fits, weighed


def _changed(weighed: tuple[Weighed, ...], found: Found, clean: CleanRecords | None, priors: Priors) -> tuple[Weighed, ...]:
    """The hypotheses without effects that baseline records of other commands ask for as well: what was there before is no change."""
    if clean is None:
        return weighed
    while (best := next((one for one in weighed if one.kind is not Kind.PARAMETERS), None)) and best.hypothesis.names:
        known = clean.show(found.hypotheses[best.hypothesis.index], priors.followed)
        if not known:
            break
        # A hypothesis that is less probable than effects of the baseline records explains a part of these.
        alone = known.issuperset(best.names)
        kept = (Kind.NOTHING, Kind.PARAMETERS)
        weighed = tuple(one for one in weighed if not (known.intersection(one.names) or (alone and one.kind not in kept)))
    total = sum(one.probability for one in weighed)
    return tuple(replace(one, probability=one.probability / total) for one in weighed) if total > 0.0 else weighed


def _with_spectrum(problem: Problem, baseline: Baseline | None, configuration: Configuration) -> Baseline | None:
    """The baseline with the model's discrepancy as a spectrum, whatever is known of it."""
    if baseline is None:
        return None
    if baseline.carried:
        return conditioned(baseline, configuration.baseline)
    if baseline.clean is None and "spectrum" in problem.model.discrepancy:
        return with_discrepancy(problem, configuration.baseline, by_spectrum=True)
    return baseline


def _with_scores(evidence: Evidence, weighed: Sequence[Weighed]) -> Evidence:
    """The evidence with the weights over "nothing" as scores."""
    none = next(one.log_weight for one in weighed if one.kind is Kind.NOTHING)
    scores = {
        one.hypothesis.index: one.log_weight - none
        for one in reversed(weighed)
        if one.kind in (Kind.EFFECTS, Kind.PARAMETERS) and not one.flicker
    }
    hypotheses = tuple(
        replace(one, score=scores.get(index, float("-inf") if index else 0.0)) for index, one in enumerate(evidence.hypotheses)
    )
    return replace(evidence, hypotheses=hypotheses)


def _decision(
    judged: Judgement, evidence: Evidence, prepared: Prepared, baseline: Baseline | None, found: Found, configuration: Configuration
) -> tuple[Decision, Evidence]:
    """The judgement with what checks of the record find, in the form of reports."""
    fitted = [one for one in judged.named if one.hypothesis.index]
    chosen = fitted[0].hypothesis.index if fitted else 0
    evidence = evidence.with_residuals(
        {
            index: residual_evidence(
                found.linearized.problem,
                found.hypotheses[index],
                prepared.findings,
                prepared.checks,
                configuration,
                companions(found.linearized, found.hypotheses[index], baseline.usual_zero, 1.0) if baseline else (),
            )
            for index in {0, chosen}
        }
    )
    left = evidence.hypotheses[chosen].residual
    assert left is not None
    noise = left.flicker if judged.named and judged.named[0].flicker else None
    shown, outliers = findings(evidence, chosen, noise, configuration.policy)
    verdict, reasons, listed = judged.verdict, set(judged.reasons), tuple(dict.fromkeys(one.hypothesis.index for one in fitted))
    shaken = None
    if verdict is Verdict.UNKNOWN:
        shaken = vibration_found(evidence, chosen, judged.something_else, configuration.policy)
    if shaken is not None:  # a vibration whose phase wanders is noise of a narrow band
        hump = evidence.hypotheses[shaken].residual
        assert hump is not None and hump.hump is not None
        shown = (*shown, vibration(hump.hump, evidence.noise[0]))
        verdict, reasons, listed, chosen = Verdict.EFFECT, set(), (chosen,) if shaken else (), shaken
    unusual = tuple(one for one in left.companions if is_unusual(one, evidence, configuration.policy))
    if verdict is Verdict.NO_GAP and (shown or unusual):
        verdict, reasons = Verdict.EFFECT, set()
    if outliers and verdict is not Verdict.UNKNOWN:
        verdict, reasons = Verdict.UNKNOWN, {Reason.OUTLIERS}
    if verdict is Verdict.EFFECT:
        reasons |= ({Reason.RECORD_CHECK} if shown else set()) | ({Reason.SESSION_DIFFERS} if unusual else set())
    other = judged.something_else if verdict is Verdict.UNKNOWN or shaken is None else 0.0
    decision = Decision(
        verdict,
        tuple(reason for reason in Reason if reason in reasons),
        chosen,
        listed,
        judged.probability,
        other,
        shown,
        outliers,
        unusual if verdict is not Verdict.UNKNOWN else (),
        (),
        other,
        other,
    )
    return decision, evidence
