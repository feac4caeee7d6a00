# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Changes in a fleet: which unit's quantity shifted, in which run, or drifts, with the number of false claims under control.

A quantity x of a unit over T runs is its level, a random walk, white noise and, perhaps, a shift from one run on or a steady trend:

    x = mu + walk + noise + delta [t >= t0]   or   x = mu + walk + noise + delta (t - t1) / (tT - t1)

The variances of noise and walk are the fleet's: their sum 2 sigma^2 + q^2 from the differences of successive runs, by the median.
q / sigma, the share of units that change and the size of changes are those that make the fleet's records most likely (empirical Bayes).
A unit that changed is said to drift where a trend explains it better than any shift.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from scipy.stats import norm

from hyst_control.base.arrays import Array
from hyst_control.fleet.course_fit import CourseFit, named_within, run_variance

SHARES = (0.001, 0.01, 0.03, 0.1, 0.3)  # Shares of units that change, among which the fleet's records choose
SHIFTS = (2.0, 4.0, 8.0, 16.0, 32.0)  # Sizes tau of a shift, in standard deviations of a run, likewise
WALKS = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 3.0)
"""Standard deviations q of a walk's step, in those sigma of the noise, likewise."""
FALSE_SHARE = 0.02  # Mean probability of an error among the units that are named, at most
MIN_RUNS = 4  # Runs of a unit from which on it is looked at
PROBABILITY = 0.9  # Of the interval of the time at which a trend is at its limit


@dataclass(frozen=True)
class Onset:
    """A change of one unit."""

    unit: str  # The unit
    quantity: str  # The quantity that changed
    probability: float  # That it changed at all
    moment: float  # Most probable first run of the change
    earliest: float  # First of the runs that hold the onset with 90 % probability
    latest: float  # Last of them
    size: float  # Shift, in the quantity's unit
    size_error: float  # Its standard error


@dataclass(frozen=True)
class Trend:
    """A steady drift of one unit."""

    unit: str  # The unit
    quantity: str  # The quantity that drifts
    probability: float  # That it changes at all
    slope: float  # Change per unit of time, in the quantity's unit
    slope_error: float  # Its standard error
    level: float  # Where the trend stands at the last run
    last: float  # Time of the last run
    walk: float  # Standard deviation that the random walk adds in a unit of time
    # crossing, earliest, latest: When the trend reaches the quantity's limit, and the times that hold it with 90 % probability;
    # None without a limit, or where it moves away from it. An end alone is None where the limit may never be reached
    crossing: float | None = None
    earliest: float | None = None
    latest: float | None = None


@dataclass(frozen=True)
class _UnitFit:
    """Shifts at every run, and a trend, in a unit's record."""

    moments: Array
    shifts: CourseFit
    trend: CourseFit

    def evidence(self, tau: float) -> float:
        """Logarithm of the odds of a change of size tau: a trend is as likely beforehand as a shift at one of all runs."""
        return float(np.logaddexp(self.shifts.evidence(tau)[0], self.trend.evidence(tau)[0]) - np.log(2.0))

    def drifts(self, tau: float) -> bool:
        """True where a trend explains the record better than the shifts."""
        return self.trend.evidence(tau)[0] > self.shifts.evidence(tau)[0]


def find_changes(
    quantity: str, units: Sequence[str], moments: Annotated[Array, "T"], values: Annotated[Array, "U T"]
) -> tuple[list[Onset], list[Trend]]:
    """Find the units whose quantity shifted or drifts."""
    looked_at = [index for index in range(len(units)) if np.isfinite(values[index]).sum() >= MIN_RUNS]
    spread = run_variance(values[looked_at]) if looked_at else 0.0
    if spread <= 0.0:
        return [], []
    best: tuple[float, float, float, float, dict[int, _UnitFit]] = (-np.inf, SHARES[0], 0.0, 0.0, {})
    for ratio in WALKS:
        white = spread / (2.0 + ratio**2)
        fits = {index: _unit_fit(moments, values[index], white, ratio**2 * white) for index in looked_at}
        run = float(np.sqrt(white * (1.0 + ratio**2)))
        unchanged = sum(fit.shifts.likelihood for fit in fits.values())
        for shift in SHIFTS:
            odds = np.array([fit.evidence(shift * run) for fit in fits.values()])
            for share in SHARES:
                whole = unchanged + float(np.logaddexp(np.log1p(-share), np.log(share) + odds).sum())
                if whole > best[0]:
                    best = (whole, share, shift * run, ratio * float(np.sqrt(white)), fits)
    _, share, tau, step, fits = best
    claims = []
    for index, fit in fits.items():
        odds = np.log(share) + fit.evidence(tau) - np.log1p(-share)
        probability = float(1.0 / (1.0 + np.exp(-np.clip(odds, -700.0, 700.0))))
        made = _trend if fit.drifts(tau) else _onset
        claims.append(made(units[index], quantity, probability, fit, tau, step))
    claims.sort(key=lambda claim: -claim.probability)
    named = claims[: named_within(np.array([claim.probability for claim in claims]), FALSE_SHARE)]
    return [claim for claim in named if isinstance(claim, Onset)], [claim for claim in named if isinstance(claim, Trend)]


def _unit_fit(moments: Array, values: Array, white: float, walk: float) -> _UnitFit:
    there = np.isfinite(values)
    t, x = moments[there], values[there]
    steps = np.tril(np.ones((len(x), len(x))))[:, 1:]  # column t: 0 before run t + 1, then 1
    ramp = ((t - t[0]) / (t[-1] - t[0]))[:, None]
    return _UnitFit(t, CourseFit(x, steps, white, walk), CourseFit(x, ramp, white, walk))


def _onset(unit: str, quantity: str, probability: float, fit: _UnitFit, tau: float, _: float) -> Onset:
    posterior = fit.shifts.evidence(tau)[1]
    likeliest = int(posterior.argmax())
    cumulative = np.cumsum(posterior)
    begins = [float(moment) for moment in fit.moments[1:]]
    first, last = (min(int(np.searchsorted(cumulative, edge)), len(begins) - 1) for edge in (0.05, 0.95))
    size, error = fit.shifts.size(likeliest, tau)
    return Onset(unit, quantity, probability, begins[likeliest], begins[first], begins[last], size, error)


def _trend(unit: str, quantity: str, probability: float, fit: _UnitFit, tau: float, step: float) -> Trend:
    duration = float(fit.moments[-1] - fit.moments[0])
    size, error = fit.trend.size(0, tau)
    level = fit.trend.level(0, size) + size
    per_time = step * float(np.sqrt((len(fit.moments) - 1) / duration))
    return Trend(unit, quantity, probability, size / duration, error / duration, level, float(fit.moments[-1]), per_time)


def forecast(trend: Trend, limits: Mapping[str, float]) -> Trend:
    """Add the time at which a trend reaches the limit of its quantity."""
    # At a time d after the last run the quantity is normal about ``level + slope d`` with the variance of the slope, (slope_error d)^2,
    # and of the walk, walk^2 d. The interval holds the times between which the probability of being beyond the limit grows from 5 to
    # 95 %; an end is None where it never does.
    limit = limits.get(trend.quantity)
    if limit is None:
        return trend
    ahead = (limit - trend.level) * np.sign(trend.slope)
    if ahead <= 0.0:
        return trend
    quantile = float(norm.ppf(0.5 + 0.5 * PROBABILITY))
    speed = abs(trend.slope)
    earliest, latest = (_reached(trend, ahead, deviations) for deviations in (quantile, -quantile))
    return replace(trend, crossing=trend.last + ahead / speed, earliest=earliest, latest=latest)


def _reached(trend: Trend, ahead: float, deviations: float) -> float | None:
    """First time at which ``speed d + deviations sqrt((slope_error d)^2 + walk^2 d)`` is `ahead`; None where there is none."""
    # Squared, it is a quadratic equation; the sign of `deviations` chooses the root.
    speed = abs(trend.slope)
    a = speed**2 - (deviations * trend.slope_error) ** 2
    b = -(2.0 * ahead * speed + (deviations * trend.walk) ** 2)
    roots = np.roots([a, b, ahead**2]) if abs(a) > 1e-12 * speed**2 else np.array([ahead**2 / -b])
    real = [float(root.real) for root in roots if abs(root.imag) < 1e-6 * abs(root) and root.real > 0.0]
    reached = [d for d in real if (ahead - speed * d) * deviations >= -1e-6 * ahead * abs(deviations)]
    return trend.last + min(reached) if reached else None
