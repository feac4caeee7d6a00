# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Structure of a gap that no known effect explains: yes/no questions, each answered by two evidences.

The gap is taken as a Gaussian process on features of the command (`chain.command_features`). A question is a group of features: the odds
of "yes" are the evidence of all features over that without the group. Where an effect comes near, the same is asked of its change,
multiplied by time, level, rate or direction of the command.
"""

from __future__ import annotations

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.chain.command_features import FEATURES, FIRST_PLAY, LAGS, PLAYS
from hyst_control.diagnose.likelihood.evidence import log_evidence
from hyst_control.diagnose.likelihood.fits import Fits, Hypothesis
from hyst_control.diagnose.likelihood.hypotheses import Priors, Weighed, weighted_octaves
from hyst_control.diagnose.likelihood.octaves import Octaves
from hyst_control.diagnose.likelihood.variables import VARIABLES

AFTER_PLAYS, AFTER_LAGS = FIRST_PLAY + len(PLAYS), FIRST_PLAY + len(PLAYS) + len(LAGS)
# In the order of `features_of_tick`: 0-2 powers of the level, 3-8 products with the rate, 9-14 distance from the last reversal, plays,
# lags, low-passed copies; `fits` adds the clock. Even ones are the same for the command turned about its middle.
GROUPS: dict[str, tuple[int, ...]] = {
    "memory": tuple(range(9, AFTER_PLAYS)),
    "even": (1, 4, 5, 10, 12),
    "rate": (*range(3, 9), *range(AFTER_PLAYS, AFTER_LAGS)),
    "slow": tuple(range(AFTER_LAGS, FEATURES)),
    "clock": (FEATURES,),
}
"""Questions, and the features that answer them."""


def structure(fits: Fits, nearest: Weighed | None, priors: Priors) -> dict[str, float]:
    """Probability of "yes" to each question."""
    octaves = weighted_octaves(fits, priors)
    found = {}
    nothing = fits.hypotheses[0]
    begin = nothing.coefficients + nothing.parameters + nothing.modulations
    count = len(nothing.fit.value) - begin
    if count:
        size = max(priors.features, key=lambda one: _value(nothing, fits, octaves, priors, np.full(count, one)))
        for question, group in GROUPS.items():
            factors = np.full(count, size)
            whole = _value(nothing, fits, octaves, priors, factors)
            factors[list(group)] = 0.0
            found[question] = _probability(whole - _value(nothing, fits, octaves, priors, factors))
    if nearest is not None and nearest.names:
        one = nearest.hypothesis
        own = one.coefficients + one.parameters
        for number, variable in enumerate(VARIABLES[: one.modulations]):
            factors = np.zeros(len(one.fit.value))
            factors[:own] = 1.0
            alone = log_evidence(one.fit.scaled(factors), octaves, nearest.end.variance, nearest.end.freedom).value
            factors[own + number] = priors.modulation
            more = log_evidence(one.fit.scaled(factors), octaves, nearest.end.variance, nearest.end.freedom).value
            found[f"{nearest.names[0]} changes with {variable}"] = _probability(more - alone)
    return found


def _value(nothing: Hypothesis, fits: Fits, octaves: Octaves, priors: Priors, sizes: Array) -> float:
    """Log evidence of features of the command of these sizes, beside an error of the smallest share of the motion."""
    variance = 1.0 + priors.motion[0][0] ** 2 * fits.motion / np.maximum(octaves.sizes, 1.0)
    factors = np.concatenate([np.ones(nothing.coefficients + nothing.parameters), np.zeros(nothing.modulations), sizes])
    return log_evidence(nothing.fit.scaled(factors), octaves, variance, octaves.degrees(variance, priors.stage_freedom)).value


def _probability(odds: float) -> float:
    return float(1.0 / (1.0 + np.exp(-np.clip(odds, -500.0, 500.0))))
