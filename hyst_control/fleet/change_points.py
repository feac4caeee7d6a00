"""Onsets in a fleet: which unit's quantity changed, in which night, with the number of false claims under control.

A quantity x of a unit over T nights is its level, a random walk, white noise and, from one night on, perhaps a shift:

    x = mu + walk + noise + delta [t >= t0],   cov(walk + noise) = sigma^2 I + q^2 min(s, t)

The two variances are the fleet's: their sum 2 sigma^2 + q^2 from the differences of successive nights, by the median. With a flat
prior of mu and delta ~ N(0, tau^2) the evidence for every night t0 has a closed form; q / sigma, the share of units that change and
tau are those that make the fleet's records most likely (empirical Bayes). Units are named, most probable first, as long as the mean
probability of an error among them stays below the bound: the Bayesian false discovery rate (Müller, Parmigiani and Rice 2006).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

Array = NDArray[np.float64]

SHARES = (0.001, 0.01, 0.03, 0.1, 0.3)
"""Shares of units that change, among which the fleet's records choose."""
SHIFTS = (2.0, 4.0, 8.0, 16.0, 32.0)
"""Sizes tau of a shift, in standard deviations of a night, likewise."""
WALKS = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 3.0)
"""Standard deviations q of a walk's step, in those sigma of the noise, likewise."""
LEAST_NIGHTS = 4
"""Nights of a unit from which on it is looked at."""
MAD = 1.4826
"""Standard deviation of a normal variable over its median absolute deviation."""


@dataclass(frozen=True)
class Onset:
    """A change of one unit.

    Parameters
    ----------
    unit
        The unit.
    quantity
        The quantity that changed.
    probability
        That it changed at all.
    moment
        Most probable first night of the change.
    earliest, latest
        Nights that hold the onset with 90 % probability.
    size, size_error
        Shift and its standard error, in the quantity's unit.
    """

    unit: str
    quantity: str
    probability: float
    moment: float
    earliest: float
    latest: float
    size: float
    size_error: float


def find_onsets(quantity: str, units: Sequence[str], moments: Array, values: Array, false_share: float = 0.02) -> list[Onset]:
    """Find the units whose quantity changed.

    Parameters
    ----------
    quantity
        Name of the quantity.
    units
        Names of the units (U,).
    moments
        Times of the nights (T,), increasing.
    values
        The quantity (U, T), NaN where there is no record.
    false_share
        Bound of the expected share of units that are named wrongly.

    Returns
    -------
    list of Onset
        The units that changed, most probable first.
    """
    looked_at = [index for index in range(len(units)) if np.isfinite(values[index]).sum() >= LEAST_NIGHTS]
    spread = _spread(np.diff(values[looked_at], axis=1)) if looked_at else 0.0
    if spread <= 0.0:
        return []
    best = (-np.inf, SHARES[0], 0.0, {})  # type: tuple[float, float, float, dict[int, _Fit]]
    for ratio in WALKS:
        white = spread / (2.0 + ratio**2)
        fits = {index: _Fit(moments, values[index], white, ratio**2 * white) for index in looked_at}
        night = float(np.sqrt(white * (1.0 + ratio**2)))
        for shift in SHIFTS:
            odds = np.array([fit.evidence(shift * night)[0] for fit in fits.values()])
            unchanged = sum(fit.likelihood for fit in fits.values())
            for share in SHARES:
                whole = unchanged + float(np.logaddexp(np.log1p(-share), np.log(share) + odds).sum())
                if whole > best[0]:
                    best = (whole, share, shift * night, fits)
    _, share, tau, fits = best
    found = []
    for index, fit in fits.items():
        evidence, posterior = fit.evidence(tau)
        odds = np.log(share) + evidence - np.log1p(-share)
        probability = float(1.0 / (1.0 + np.exp(-np.clip(odds, -700.0, 700.0))))
        likeliest = int(posterior.argmax())
        cumulative = np.cumsum(posterior)
        first, last = (int(np.searchsorted(cumulative, edge)) for edge in (0.05, 0.95))
        size, error = fit.shift(likeliest, tau)
        begins = fit.begins
        last = min(last, len(begins) - 1)
        found.append(Onset(units[index], quantity, probability, begins[likeliest], begins[first], begins[last], size, error))
    found.sort(key=lambda onset: -onset.probability)
    errors = np.cumsum([1.0 - onset.probability for onset in found]) / np.arange(1, len(found) + 1)
    return found[: int(np.searchsorted(errors, false_share, side="right"))]


class _Fit:
    """Generalized least squares of a unit's nights with a shift at each of them in turn."""

    def __init__(self, moments: Array, values: Array, white: float, walk: float) -> None:
        there = np.isfinite(values)
        x, t = values[there], moments[there]
        place = np.arange(len(x), dtype=float)
        factor = cho_factor(white * np.eye(len(x)) + walk * np.minimum.outer(place + 1.0, place + 1.0))
        steps = np.tril(np.ones((len(x), len(x))))[:, 1:]  # column t: 0 before night t + 1, then 1
        ones = np.ones(len(x))
        weight = cho_solve(factor, ones)
        level = (weight @ x) / weight.sum()
        rest = cho_solve(factor, x - level)
        information = np.einsum("ij,ij->j", steps, cho_solve(factor, steps)) - (weight @ steps) ** 2 / weight.sum()
        self.begins = [float(moment) for moment in t[1:]]
        self._variance = 1.0 / information
        self._shift = (rest @ steps) / information
        self.likelihood = -float(np.log(np.diag(factor[0])).sum() + 0.5 * np.log(weight.sum()) + 0.5 * (x - level) @ rest)

    def evidence(self, tau: float) -> tuple[float, Array]:
        """Logarithm of the odds of a shift of size tau, and the probability of each night, given that there is one."""
        total = self._variance + tau**2
        each = 0.5 * (np.log(self._variance / total) + self._shift**2 * (1.0 / self._variance - 1.0 / total))
        highest = float(each.max())
        relative = np.exp(each - highest)
        return highest + float(np.log(relative.mean())), relative / relative.sum()

    def shift(self, index: int, tau: float) -> tuple[float, float]:
        """Shift at a night and its standard error, under the prior tau."""
        shrunk = tau**2 / (tau**2 + self._variance[index])
        return float(shrunk * self._shift[index]), float(np.sqrt(shrunk * self._variance[index]))


def _spread(differences: Array) -> float:
    """Variance of differences of successive nights; robust to a few that change."""
    known = differences[np.isfinite(differences)]
    if not len(known):
        return 0.0
    spread = MAD * np.median(np.abs(known - np.median(known)))
    return float(spread**2) if spread > 0.0 else float(np.var(known))
