# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Marginal likelihood of a hypothesis by Laplace's approximation, everything that is fitted integrated out.

    log Z = log p(r̂) - Σ ρ(v̂) + log normalization of ρ - ½ log det H

r̂: what the best fit leaves, by octaves (`octaves`); v: all that is fitted, in units of its prior: coefficients of the model and session
effects z ~ N(0, 1), parameters x of effects with a heavy-tailed prior, and what a hypothesis may add. H is the curvature by v, octave by
octave weighted as the likelihood has it. Residual and derivatives are needed as sums of products by octave only, so that the fit goes on
with any variance at next to no cost.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gammaln

from hyst_control.base.arrays import Array
from hyst_control.diagnose.likelihood.octaves import Octaves
from hyst_control.diagnose.search.fit import TAIL

ROUNDS = 8  # Steps with renewed weights
LENGTHS = (1.0, 0.5, 0.25)  # Lengths of a step that are tried
ENOUGH = 0.01  # Gain (nats) under which no further step is taken
NORMALIZATION = float(
    0.5 * np.log(2.0 * np.pi) - np.log(TAIL * np.sqrt(np.pi)) - gammaln(0.5 * (TAIL**2 - 1.0)) + gammaln(0.5 * TAIL**2)
)
"""Logarithm of the heavy-tailed prior's density in its middle over that of a normal one."""


@dataclass(frozen=True)
class Fit:
    """A hypothesis near its best fit: v (N,) in units of its prior, and sums of products by octave (B, …)."""

    value: Array  # (N,) from the middle of the prior
    lower: Array  # (N,)
    upper: Array  # (N,)
    heavy: Array  # (N,) True where the prior has a heavy tail
    gram: Array  # (B, N, N) of the derivatives by v
    right: Array  # (B, N) of the derivatives and the residual
    energy: Array  # (B,) of the residual

    @classmethod
    def of(cls, octaves: Octaves, residual: Array, design: Array, value: Array, heavy: Array, bounds: tuple[Array, Array]) -> Fit:
        """Sum products by octave, of the residual (M,) and the derivatives (M, N)."""
        gram, right = np.zeros((len(octaves.own), len(value), len(value))), np.zeros((len(octaves.own), len(value)))
        for octave in np.flatnonzero(octaves.sizes):
            here = octaves.index == octave
            part = design[here]
            gram[octave], right[octave] = part.T @ part, part.T @ residual[here]
        return cls(value, *bounds, heavy, gram, right, octaves.energies(residual))

    def moved(self, step: Array) -> Fit:
        """The fit after a step along its derivatives."""
        along = self.gram @ step
        energy = self.energy - 2.0 * self.right @ step + along @ step
        return replace(self, value=self.value + step, right=self.right - along, energy=np.maximum(energy, 0.0))

    def scaled(self, factors: Array) -> Fit:
        """The same with priors that many times as wide; what is 0 is not fitted."""
        kept = factors > 0.0
        f = factors[kept]
        with np.errstate(invalid="ignore"):
            lower, upper = self.lower[kept] / f, self.upper[kept] / f
        gram = self.gram[:, kept][:, :, kept] * np.outer(f, f)
        return Fit(self.value[kept] / f, lower, upper, self.heavy[kept], gram, self.right[:, kept] * f, self.energy)


@dataclass(frozen=True)
class LogEvidence:
    """Log marginal likelihood of a hypothesis, and the fit it is taken at."""

    value: float
    fit: Fit
    variance: Array  # (B,)
    freedom: Array  # (B,) degrees of freedom of the variance


def log_evidence(fit: Fit, octaves: Octaves, variance: Array, freedom: Array) -> LogEvidence:
    """Fit on with octaves of these variances, known by these degrees of freedom, and integrate out what is fitted."""

    def log_joint(one: Fit) -> float:
        return octaves.log_density(one.energy, variance, freedom) - prior_misfit(one)

    def curved(one: Fit) -> tuple[Array, Array]:
        precision, prior = octaves.precision(one.energy, variance, freedom), prior_weight(one)
        curvature = np.tensordot(precision, one.gram, axes=1)
        curvature[np.diag_indices(len(prior))] += prior
        return curvature, precision @ one.right - prior * one.value

    best = log_joint(fit)
    for _ in range(ROUNDS if len(fit.value) else 0):
        step = _inside(fit, *curved(fit))
        tried = (fit.moved(length * step) for length in LENGTHS)
        better = next(((one, value) for one in tried if (value := log_joint(one)) > best), None)
        if better is None:
            break
        gained = better[1] - best
        fit, best = better
        if gained < ENOUGH:
            break
    curvature = _exact(fit, octaves, variance, freedom, curved(fit)[0])
    occam = -0.5 * _log_determinant(curvature) + NORMALIZATION * np.count_nonzero(fit.heavy)
    return LogEvidence(best + occam, fit, variance, freedom)


def _exact(fit: Fit, octaves: Octaves, variance: Array, freedom: Array, rough: Array) -> Array:
    """Second derivative of the negative log joint density, without the curvature of the simulation; `rough` where it is no minimum."""
    precision = octaves.precision(fit.energy, variance, freedom)
    square = (fit.value / TAIL) ** 2
    bent = np.where(fit.heavy, (1.0 - square) / (1.0 + square) ** 2 - 1.0 / (1.0 + square), 0.0)
    falling = 2.0 * precision**2 / (freedom + octaves.weight * octaves.sizes)
    exact = rough + np.diag(bent) - (fit.right * falling[:, None]).T @ fit.right
    return exact if np.all(np.linalg.eigvalsh(exact) > 0.0) else rough


def _inside(fit: Fit, curvature: Array, slope: Array) -> Array:
    """Newton's step; what would leave its range is held at its end, and the others go on from there."""
    step = _solved(curvature, slope)
    out = np.flatnonzero((fit.value + step < fit.lower) | (fit.value + step > fit.upper))
    if not len(out):
        return step
    held = np.clip(fit.value[out] + step[out], fit.lower[out], fit.upper[out]) - fit.value[out]
    free = np.setdiff1d(np.arange(len(step)), out)
    fresh = np.empty_like(step)
    fresh[out] = held
    fresh[free] = _solved(curvature[np.ix_(free, free)], slope[free] - curvature[np.ix_(free, out)] @ held)
    return np.clip(fit.value + fresh, fit.lower, fit.upper) - fit.value


def _solved(curvature: Array, slope: Array) -> Array:
    """Newton's step; directions that rounding hides, as where derivatives run away, are not gone along."""
    size = np.sqrt(np.diag(curvature))
    step: Array = np.linalg.lstsq(curvature / np.outer(size, size), slope / size, rcond=None)[0] / size
    return step


def _log_determinant(curvature: Array) -> float:
    """Of a positive curvature; directions that rounding hides count as what rounding leaves, so that they are not for free."""
    size = np.diag(curvature)
    values = np.linalg.eigvalsh(curvature / np.sqrt(np.outer(size, size)))
    return float(np.sum(np.log(size)) + np.sum(np.log(np.maximum(values, np.finfo(float).eps))))


def prior_misfit(fit: Fit) -> float:
    """Negative logarithm of the prior's density, in that of its middle."""
    tails = 0.5 * TAIL**2 * np.log1p((fit.value / TAIL) ** 2)
    return float(np.sum(np.where(fit.heavy, tails, 0.5 * fit.value**2)))


def prior_weight(fit: Fit) -> Array:
    """Weights of the squares with which they have the prior's slope."""
    return np.where(fit.heavy, 1.0 / (1.0 + (fit.value / TAIL) ** 2), 1.0)
