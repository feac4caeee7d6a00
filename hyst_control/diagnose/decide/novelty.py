# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Signs of an effect outside the catalogue, and the novelty score that they add up to. Pure functions of the evidence.

A sign is a number of which 1 is the threshold that a rule was set with; of several conditions it is the weakest one. The verdict is
`unknown` where the clearest sign exceeds `novelty_threshold`: of the single effects that it was calibrated on, at most 4 % do.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hyst_control.diagnose.configuration import Thresholds
from hyst_control.diagnose.decide.record_findings import residual_of, share_of_outliers
from hyst_control.diagnose.evidence import Evidence, HypothesisEvidence, Outliers
from hyst_control.diagnose.verdict import Reason


def signs(
    evidence: Evidence, chosen: int, outweighed: bool, outliers: Sequence[Outliers], thresholds: Thresholds
) -> dict[Reason, float]:
    """Measure the signs of an unknown effect beside an explanation."""
    one, residual = evidence.hypotheses[chosen], residual_of(evidence, chosen)
    beyond = (residual.energy - evidence.stated) / _noticed(evidence, thresholds)
    found: dict[Reason, float] = {}
    if not outweighed:
        found[Reason.ENERGY_LEFT] = min(beyond, _share_left(evidence, chosen, thresholds) / thresholds.unknown_share)
    found[Reason.OUTLIERS] = max([0.0, *(share_of_outliers(evidence, each) / thresholds.unknown_share for each in outliers)])
    if one.names:
        share = unexplained(evidence, chosen, thresholds) / thresholds.named_unexplained_share
        found[Reason.UNEXPLAINED_SHARE] = min(share, max(beyond, one.farthest / thresholds.many_tolerances))
    if _too_many(evidence, chosen, thresholds):
        found[Reason.TOO_MANY_EFFECTS] = one.together / thresholds.max_effects
    found[Reason.DISTORTION_LEVEL] = max([0.0, *(sign for _, sign in stands(evidence, chosen, thresholds))])
    return found


def score(evidence: Evidence, chosen: int, found: Mapping[Reason, float], at_bound: bool, thresholds: Thresholds) -> float:
    """Compute the novelty score m / (m + q), where m is the clearest sign and q the conformal threshold: above 0.5 all is `unknown`."""
    # at_bound: true where the one explanation has an effect at the end of its range: how far beyond it the effect would be nobody
    # knows
    threshold = thresholds.novelty_threshold
    clearest = max([0.0, *found.values()])
    if not evidence.hypotheses[chosen].names:  # of coefficients alone no rule makes an unknown effect
        clearest = max(clearest, min(unexplained(evidence, chosen, thresholds), threshold))
    if at_bound:
        clearest = max(clearest, float(np.nextafter(threshold, np.inf)))
    return clearest / (clearest + threshold)


def stands(evidence: Evidence, chosen: int, thresholds: Thresholds) -> list[tuple[int, float]]:
    """Axes whose measurement stays on one value again and again, each with its sign."""
    if evidence.repeating.intersection(evidence.hypotheses[chosen].names):
        return []
    found = []
    for axis, seen in enumerate(evidence.record):
        # One stretch is none that came back; half a stretch short of the threshold is on it.
        often = (seen.stuck - 1.0) / (thresholds.stuck - 1.5)
        sign = min(often, seen.stuck / max(thresholds.beyond_clean * seen.usual_stuck, 1e-300))
        if sign > 0.0:
            found.append((axis, sign))
    return found


def remainder(evidence: Evidence, chosen: int, thresholds: Thresholds) -> float:
    """Share of the gap's energy that the `chosen` explanation of the `evidence` leaves, 0 where that is under the floor in `thresholds`."""
    beyond = residual_of(evidence, chosen).energy - evidence.stated
    return _share_left(evidence, chosen, thresholds) if beyond > _noticed(evidence, thresholds) else 0.0


def leaves_more(evidence: Evidence, one: HypothesisEvidence, thresholds: Thresholds) -> bool:
    """True where a hypothesis leaves significantly more energy than the model is expected to leave."""
    return one.energy - evidence.stated > _noticed(evidence, thresholds)


def _noticed(evidence: Evidence, thresholds: Thresholds) -> float:
    """Smallest excess energy that counts: above the practical floor and above the uncertainty of the noise estimate."""
    return float(max(evidence.floor**2, _excess(evidence, thresholds) * evidence.stated))


def _excess(evidence: Evidence, thresholds: Thresholds) -> float:
    """Smallest significant excess, relative to the expected energy."""
    # The standard error of a median over n spectral lines, of which two thirds are independent under Hann's window.
    by_chance = thresholds.noise_deviations * np.sqrt(1.5 / max(evidence.noise_bins, 1.0)) / np.log(2.0)
    return float(max(thresholds.min_excess, by_chance))


def unexplained(evidence: Evidence, chosen: int, thresholds: Thresholds) -> float:
    """Share of the gap's energy that an explanation leaves, or removes by coefficients many tolerances away only.

    Of a change that needs a coefficient n times as far away as the most that is believed, that most removes all but (1 - 1/n)² of
    the energy. What an effect outside the catalogue does to the output is taken up by coefficients in just this way.
    """
    one, before = evidence.hypotheses[chosen], evidence.before(chosen) - evidence.stated
    if not (one.names or one.coefficients_alone):
        return 0.0
    beyond = (1.0 - min(thresholds.many_tolerances / max(one.farthest, 1e-300), 1.0)) ** 2
    if before <= thresholds.min_excess * evidence.stated:
        return beyond  # coefficients took all of it
    if one.names:
        beyond = min(beyond, one.taken_up / before)
    left = residual_of(evidence, chosen)
    return max(beyond, float(np.clip((left.energy - evidence.stated) / before, 0.0, 1.0)))


def _too_many(evidence: Evidence, chosen: int, thresholds: Thresholds) -> bool:
    """True where so many effects at once are less likely than one outside the catalogue, and few of them do not explain nearly all."""
    names = set(evidence.hypotheses[chosen].names)
    if evidence.hypotheses[chosen].together <= thresholds.max_effects:
        return False
    before = max(evidence.hypotheses[0].energy - evidence.stated, 1e-12)
    return not any(
        one.energy - evidence.stated <= thresholds.unknown_share * before
        for one in evidence.hypotheses
        if one.names and one.together <= thresholds.max_effects and set(one.names) < names
    )


def _share_left(evidence: Evidence, chosen: int, thresholds: Thresholds) -> float:
    """Share of the gap's energy that the chosen explanation leaves, however little that is."""
    before, after = evidence.before(chosen), residual_of(evidence, chosen).energy
    due = evidence.stated
    # What does not follow the command varies from run to run, and no effect would explain it. Where baseline records show how much that
    # is, many times as much is something new all the same.
    left, follows = after - due, residual_of(evidence, chosen).predictable
    usual = thresholds.run_to_run * due if due > 1.0 or evidence.whitened else np.inf
    new = follows * left + max((1.0 - follows) * left - usual, 0.0)
    return float(np.clip(new / max(before - due, 1e-12), 0.0, 1.0))
