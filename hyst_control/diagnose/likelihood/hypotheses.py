# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The list of hypotheses with their prior probabilities, weighed against one another by one marginal likelihood.

    nothing         the record differs by noise, coefficients within their tolerance, session effects and the model's discrepancy
    parameters      coefficients further off than their tolerance
    effects         one effect of the catalogue, or several
    1/f noise       beside nothing, or beside effects
    something else  what the model, or an effect, does not do: features of the command; the change of an effect, that depends on time,
                    level, rate or direction; and any error by octaves

A stage of the catalogue is hardly the physics: in every octave it is off by a share ε of what it changes, of a broad prior. With a small
share the effect is that of its name, with a large one it is something else.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from scipy.special import logsumexp

from hyst_control.base.arrays import Array
from hyst_control.diagnose.likelihood.evidence import Fit, LogEvidence, log_evidence
from hyst_control.diagnose.likelihood.fits import Fits, Hypothesis
from hyst_control.diagnose.likelihood.octaves import Octaves
from hyst_control.diagnose.record_checks.summary import effect_found_by
from hyst_control.effects.effect import RecordCheck

FALLING = effect_found_by(RecordCheck.FALLING_SPECTRUM)
FLICKER = "" if FALLING is None else FALLING.name  # Name of 1/f noise
Weights = tuple[tuple[float, float], ...]  # Values of a number that is not known, each with its prior probability


class Kind(Enum):
    """Kind of a hypothesis."""

    NOTHING = "nothing"
    PARAMETERS = "parameters"
    EFFECTS = "effects"
    SOMETHING_ELSE = "something_else"


@dataclass(frozen=True)
class Priors:
    """Numbers of the likelihood core."""

    nothing: float = 0.4  # Prior probability of no gap
    parameters: float = 0.05  # Of coefficients beyond their tolerance
    single: float = 0.4  # Of one effect, shared by all that were tried
    further: float = 0.1  # Odds of each effect more
    flicker: float = 0.02  # Of 1/f noise beside any of them
    else_odds: float = 0.1  # Odds of something else that is like an effect, against that effect
    unlike: float = 0.02  # Prior probability of something else that is like no effect
    stage: Weights = ((0.0, 0.4), (0.01, 0.25), (0.03, 0.2), (0.1, 0.15))  # Share ε of a stage of the catalogue
    other: Weights = ((0.25, 0.4), (0.5, 0.4), (1.0, 0.2))  # Of something else
    stage_freedom: float = 3.0  # Degrees of freedom of its scale in an octave
    modulation: float = 0.5  # Size of the change with time, level, rate and direction of something else
    features: tuple[float, ...] = (0.1, 0.3, 1.0, 3.0)  # Weights of the command's features, per cent of the range
    motion: Weights = (
        (0.001, 0.25),
        (0.003, 0.25),
        (0.01, 0.25),
        (0.03, 0.25),
    )  # Share of the motion that it is off by, by octaves
    leading: int = 3  # Hypotheses beside which 1/f noise and something else are tried
    values: float = 8.0  # Independent values of an octave in which a model's error is larger than the noise
    flicker_powers: tuple[float, ...] = (0.8, 1.0, 1.3)  # Powers of the frequency
    flicker_sizes: tuple[float, ...] = (0.003, 0.01, 0.03, 0.1, 0.3, 1.0)  # Its power at the top in that of the white noise
    temperature: float = 0.5  # Factor of the log evidences: by log loss on cases of tuning seeds
    level: float = 0.9  # Probability of the set of explanations that is named
    alarm: float = 0.05  # A gap is named only if "no gap" is less probable than this
    combined: float = 1e-6  # Probability of something else from which combinations of effects are tried
    parents: int = 2  # Explanations that a further effect is added to
    screened: int = 3  # More starts of an effect are ranked first, by a linear step from each
    followed: float = 8.0  # Gain from which a search adds further effects, nats
    kept: int = 14  # Single effects, and combinations, that are weighed: those that come closest
    freedom: float = 4.0  # Degrees of freedom of the discrepancy's scale in an octave


PRIORS = Priors()


@dataclass(frozen=True)
class Weighed:
    """A hypothesis with its weight."""

    kind: Kind
    names: tuple[str, ...]  # Effects; of something else those that it is like
    log_weight: float  # Log evidence and log prior, nats
    log_prior: float
    hypothesis: Hypothesis  # The fit that leads among its realizations
    end: LogEvidence  # Where that fit ends
    flicker: bool = False  # True beside 1/f noise
    probability: float = 0.0


def weigh(fits: Fits, priors: Priors) -> tuple[Weighed, ...]:
    """Weigh all hypotheses, the most probable first."""
    octaves = weighted_octaves(fits, priors)
    plain = [_plain(hypothesis, fits, octaves, priors) for hypothesis in fits.hypotheses]
    effects = sorted((one for one in plain if one.kind is Kind.EFFECTS), key=lambda one: -one.log_weight)
    none = [one for one in plain if one.kind is Kind.NOTHING]
    found = [*plain, *(more for one in none + effects[: priors.leading] for more in _further(one, fits, octaves, priors))]
    found = list(_by_name(found))
    tempered = [priors.temperature * (one.log_weight - one.log_prior) + one.log_prior for one in found]
    shares = np.exp(np.array(tempered) - logsumexp(tempered))
    found = [replace(one, probability=float(share)) for one, share in zip(found, shares, strict=True)]
    return tuple(sorted(found, key=lambda one: -one.probability))


def weighted_octaves(fits: Fits, priors: Priors) -> Octaves:
    """Octaves with the weight that what the best explanation leaves gives them."""
    plain, sizes = fits.octaves, np.maximum(fits.octaves.sizes, 1.0)
    ones = np.ones(len(sizes))
    freedom = plain.degrees(ones, priors.stage_freedom)
    left = [
        log_evidence(_fit(one), plain, ones, freedom).fit.energy / sizes for one in fits.hypotheses if not one.coefficients_alone
    ]
    best = min(left, key=lambda energy: float(np.sum(sizes * energy)))
    return plain.weighted(best, priors.values)


def _fit(hypothesis: Hypothesis, modulation: float = 0.0, features: float = 0.0) -> Fit:
    """The fit of a hypothesis with what is modulated, and features of the command, of these sizes."""
    count = len(hypothesis.fit.value)
    own, further = hypothesis.coefficients + hypothesis.parameters, hypothesis.modulations
    factors = np.ones(count)
    factors[own : own + further] = modulation
    factors[own + further :] = features
    return hypothesis.fit.scaled(factors)


def _plain(hypothesis: Hypothesis, fits: Fits, octaves: Octaves, priors: Priors) -> Weighed:
    """A hypothesis of the search, the stage of an effect off by a share that is not known."""
    kind = Kind.PARAMETERS if hypothesis.coefficients_alone else Kind.EFFECTS if hypothesis.names else Kind.NOTHING
    stage = priors.stage if hypothesis.names else ((0.0, 1.0),)
    value, end = _mixed(_fit(hypothesis), octaves, _by_share(stage, hypothesis.change, octaves, priors))
    prior = _log_prior(hypothesis, fits, priors)
    return Weighed(kind, hypothesis.names, value + prior - np.log(hypothesis.realizations), prior, hypothesis, end)


def _further(one: Weighed, fits: Fits, octaves: Octaves, priors: Priors) -> Iterator[Weighed]:
    """A hypothesis beside 1/f noise, and something else that is like it, or like nothing."""
    hypothesis = one.hypothesis
    own, fit = float(np.log(hypothesis.realizations)), _fit(hypothesis)
    # Of several axes nobody knows whose noise it is; and beside rounding errors white noise, which tells 1/f noise, is not seen.
    if octaves.per_axis == len(octaves.own) and np.max(fits.noise[octaves.sizes > 0.0]) > 0.5:
        grid = [(power, top) for power in priors.flicker_powers for top in priors.flicker_sizes]
        each = [(one.end.variance + flicker_variance(fits, *at), one.end.freedom, 1.0 / len(grid)) for at in grid]
        value, end = _mixed(fit, octaves, each)
        prior = one.log_prior + float(np.log(priors.flicker))
        yield Weighed(Kind.EFFECTS, (*one.names, FLICKER), value + prior - own, prior, hypothesis, end, True)
    if one.names:
        either = tuple((share, 0.5 * weight) for share, weight in priors.stage + priors.other)
        shares = _by_share(either, hypothesis.change, octaves, priors)
        value, end = _mixed(_fit(hypothesis, priors.modulation), octaves, shares)
        prior = one.log_prior + float(np.log(priors.else_odds))
    else:
        value, end = _unlike(hypothesis, fits, octaves, priors)
        prior = float(np.log(priors.unlike))
    yield Weighed(Kind.SOMETHING_ELSE, one.names, value + prior - own, prior, hypothesis, end)


def _unlike(hypothesis: Hypothesis, fits: Fits, octaves: Octaves, priors: Priors) -> tuple[float, LogEvidence]:
    """Something that is like no effect: features of the command, and an error by octaves that is a share of the motion."""
    sizes = (0.0, *priors.features)
    each = [_mixed(_fit(hypothesis, 0.0, size), octaves, _by_share(priors.motion, fits.motion, octaves, priors)) for size in sizes]
    values = [value for value, _ in each]
    return float(logsumexp(values)) - float(np.log(len(sizes))), each[int(np.argmax(values))][1]


def _by_share(shares: Weights, energy: Array, octaves: Octaves, priors: Priors) -> Iterator[tuple[Array, Array, float]]:
    """Variance and degrees of freedom by octave, for each share of something of this energy that is an error of its own."""
    power = energy / np.maximum(octaves.sizes, 1.0)
    for share, weight in shares:
        variance = 1.0 + share**2 * power
        yield variance, octaves.degrees(variance, priors.stage_freedom), weight


def _mixed(fit: Fit, octaves: Octaves, variances: Iterable[tuple[Array, Array, float]]) -> tuple[float, LogEvidence]:
    """Log evidence of variances of which one holds, each of a prior probability, and that of the likeliest."""
    each = [(log_evidence(fit, octaves, variance, freedom), weight) for variance, freedom, weight in variances]
    values = [one.value + np.log(weight) for one, weight in each]
    return float(logsumexp(values)), each[int(np.argmax(values))][0]


def flicker_variance(fits: Fits, power: float, top: float) -> Array:
    """Variance by octave of noise that falls with a power of the frequency, in that of noise and discrepancy."""
    count = len(fits.noise)
    rank = np.arange(count) % fits.octaves.per_axis
    below = fits.octaves.per_axis - 1 - rank
    return np.asarray(top * 2.0 ** (power * below) * fits.noise, dtype=np.float64)


def _log_prior(hypothesis: Hypothesis, fits: Fits, priors: Priors) -> float:
    """Log prior probability of a hypothesis, all realizations of its effects together."""
    if hypothesis.coefficients_alone:
        return float(np.log(priors.parameters))
    if not hypothesis.names:
        return float(np.log(priors.nothing))
    number = len(hypothesis.names)
    return float(np.log(priors.single) + (number - 1) * np.log(priors.further) - number * np.log(fits.effects))


def _by_name(found: Sequence[Weighed]) -> Iterator[Weighed]:
    """One of each kind and name: the weights of an effect's realizations add up."""
    groups: dict[tuple[Kind, tuple[str, ...]], list[Weighed]] = {}
    for one in found:
        groups.setdefault((one.kind, tuple(sorted(one.names))), []).append(one)
    for group in groups.values():
        best = max(group, key=lambda one: one.log_weight)
        yield replace(best, log_weight=float(logsumexp([one.log_weight for one in group])))
