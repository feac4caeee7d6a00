# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Verdicts of a diagnosis, their machine-readable reasons, and the decisions that carry both."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from hyst_control.diagnose.evidence import CompanionEvidence, Finding, Outliers


class Verdict(str, Enum):
    """Verdict of a diagnosis, in the order in which they prevail over one another."""

    UNKNOWN = "unknown"
    AMBIGUOUS = "ambiguous"
    EFFECT = "effect"
    PARAMETERS = "parameters"
    NO_GAP = "no_gap"


class Reason(str, Enum):
    """Reason of a verdict."""

    ENERGY_LEFT = "energy_left"  # Unknown: the best explanation leaves more of the gap's energy than it may
    OUTLIERS = "outliers"  # Unknown: what is left is single samples that stand out
    TOO_MANY_EFFECTS = "too_many_effects"  # Unknown: the best explanation needs more effects at once than are likely
    AT_BOUND = "at_bound"  # Unknown: the one explanation has an effect at the end of its range
    # Unknown: beside the effects much of the gap is left, or taken up by coefficients many tolerances away.
    UNEXPLAINED_SHARE = "unexplained_share"
    DISTORTION_LEVEL = "distortion_level"  # Unknown: the measurement stays on one value while the command moves
    # Unknown: by the likelihood of all hypotheses, something that none of them is, is more probable than all of them.
    SOMETHING_ELSE = "something_else"
    SEVERAL_EXPLANATIONS = "several_explanations"  # Ambiguous: more than one explanation is probable
    ONE_EXPLANATION = "one_explanation"  # Effect: one explanation is sure
    NO_OTHER_EXPLANATION = "no_other_explanation"  # Effect: one explanation is not sure, but every other is improbable
    RECORD_CHECK = "record_check"  # Effect: a check of the record found an effect without a waveform
    SESSION_DIFFERS = "session_differs"  # Effect: zero or drift of the session differ, more than between baseline records
    NOISE_EXPLAINS_MORE = "noise_explains_more"  # Effect: 1/f noise explains more than any effect with a waveform
    # Parameters: coefficients further off than their tolerance explain the gap.
    COEFFICIENTS_BEYOND_TOLERANCE = "coefficients_beyond_tolerance"
    # Parameters: the tolerances explain the gap, but the simulation as given is so far off that a user has to act.
    COEFFICIENTS_WITHIN_TOLERANCE = "coefficients_within_tolerance"
    BELOW_PRACTICAL_SIZE = "below_practical_size"  # No gap: what beats the simulated null is too small to be worth naming
    BELOW_NULL = "below_null"  # No gap: nothing beats what records without a gap score by chance


@dataclass(frozen=True)
class Decision:
    """Decision on one problem."""

    verdict: Verdict
    reasons: tuple[Reason, ...]  # In the order of the enumeration, at least one
    chosen: int  # Index of the best explanation among the hypotheses
    listed: tuple[int, ...]  # Explanations that the data cannot tell from it, best first, itself among them
    probability: Mapping[tuple[str, ...], float]  # By the names of an explanation
    remainder: float  # Share of the gap's energy that is left unexplained, 0 where that is under the floor
    findings: tuple[Finding, ...] = ()  # Effects without a waveform
    outliers: tuple[Outliers, ...] = ()  # What excess noise consists of, where it is outliers
    companions: tuple[CompanionEvidence, ...] = ()  # Zero and drift of the session, where they are named
    stands: tuple[int, ...] = ()  # Axes whose measurement stays on one value while the command moves
    # Share of the gap's energy that no known effect explains with coefficients that are near their tolerances, however small
    unexplained: float = 0.0
    # Novelty score, 0 … 1: m / (m + q), m the clearest sign of an unknown effect, q the conformal threshold; see `novelty`
    novelty: float = 0.0

    def of(self, name: str) -> float:
        """Probability that an effect is at work."""
        return float(sum(p for names, p in self.probability.items() if name in names))


@dataclass(frozen=True)
class JointDecision:
    """Decision over all axes: the verdict that prevails, its reasons, and the largest remainder, unexplained share and novelty."""

    verdict: Verdict
    reasons: tuple[Reason, ...]
    remainder: float
    unexplained: float = 0.0
    novelty: float = 0.0
