# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Gap reduction by an explanation, on blocks of the record that neither chose nor fitted it, relative to the noise floor.

    shrink = 1 - (E_after² - floor²) / (E_before² - floor²)

raw: the nominal model as given before, and with the effects added after; re-identified: its coefficients fitted within their
tolerance on both sides. Every other block is fitted and the rest evaluated; then the two sets of blocks change roles. Companions (a
session's zero, its initial memory) are free on the blocks that are evaluated too: what they are there, other blocks do not say.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from itertools import combinations
from math import factorial
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array, Mask
from hyst_control.base.errors import InputError
from hyst_control.diagnose.configuration import CONFIGURATION, ReductionSettings
from hyst_control.diagnose.search.beam_search import FittedHypothesis
from hyst_control.diagnose.search.fit import Linearized, fit


@dataclass(frozen=True)
class HeldOut:
    """Squared errors on samples that did not fit, in noise energies."""

    # before, after: Of the nominal model, and with the effects
    before: Annotated[Array, "M"]
    after: Annotated[Array, "M"]
    # before_fitted, after_fitted: The same with coefficients fitted
    before_fitted: Annotated[Array, "M"]
    after_fitted: Annotated[Array, "M"]


def held_out(
    linearized: Linearized,
    explanations: Sequence[FittedHypothesis],
    none: FittedHypothesis,
    settings: ReductionSettings = CONFIGURATION.reduction,
) -> tuple[HeldOut, list[HeldOut]]:
    """Squared errors without an effect and of explanations, by two-fold blocked cross-validation."""
    count, halves = len(linearized.measured), _halves(linearized, settings)

    def left(within: Linearized, simulated: Array, rows: Mask) -> Array:
        error = linearized.problem.in_noise(linearized.measured - simulated)[rows]
        return _beside_companions(_companions(within)[rows], error) ** 2

    as_given = linearized.simulate(linearized.companions(none.solution.z))
    without = Linearized(linearized.problem, linearized.scatter, none.solution.z)
    before, before_fitted = np.empty(count), np.empty(count)
    for rows, weight in halves:
        alone = fit(without, z=none.solution.z, weight=weight, rounds=settings.rounds)
        before[rows] = left(without, as_given, rows)
        before_fitted[rows] = left(without, linearized.simulate(alone.z), rows)
    nothing, found = HeldOut(before, before, before_fitted, before_fitted), []
    for scored in explanations:
        if scored.candidate is None:
            found.append(nothing)
            continue
        unknowns, x = scored.candidate.unknowns(), scored.solution.x
        within = Linearized(linearized.problem, linearized.scatter, scored.solution.z, unknowns, x)
        after, after_fitted = np.empty(count), np.empty(count)
        for rows, weight in halves:
            both = fit(within, unknowns, x, scored.solution.z, weight=weight, rounds=settings.rounds)
            after_fitted[rows] = left(within, linearized.simulate(both.z, unknowns, both.x), rows)
            after[rows] = left(within, linearized.simulate(linearized.companions(both.z), unknowns, both.x), rows)
        found.append(HeldOut(before, after, before_fitted, after_fitted))
    return nothing, found


def _halves(linearized: Linearized, settings: ReductionSettings) -> list[tuple[Mask, Array]]:
    """Samples (M,) of every other block that are held out, and weights of those that are fitted then; of either half."""
    count = len(linearized.measured)
    fold = (np.arange(count) * settings.blocks // count) % 2
    return [(fold == held, (fold != held).astype(float)) for held in (0, 1)]


def _companions(linearized: Linearized) -> Array:
    """Columns (M, C) of the companions, in units of the noise."""
    columns = [linearized.problem.in_noise(column) for column in linearized.columns[:, linearized.scatter.companions > 0].T]
    return np.stack(columns, axis=1) if columns else np.zeros((len(linearized.measured), 0))


def _beside_companions(columns: Array, residual: Array) -> Array:
    """A residual (N,) without what columns (N, K) explain of it within their priors."""
    if not columns.shape[1]:
        return residual
    gram = columns.T @ columns + np.eye(columns.shape[1])
    return np.asarray(residual - columns @ np.linalg.solve(gram, columns.T @ residual), dtype=np.float64)


def shrink(
    before: Annotated[Array, "M"], after: Annotated[Array, "M"], seed: int, settings: ReductionSettings = CONFIGURATION.reduction
) -> tuple[float, tuple[float, float]]:
    """Reduction and its interval by a moving-block bootstrap."""

    def ratio(b: float, a: float) -> float:
        return float(np.clip(1.0 - (a - 1.0) / max(b - 1.0, 1e-12), -10.0, 1.0))

    value = ratio(float(before.mean()), float(after.mean()))
    length = max(len(before) // (2 * settings.blocks), 1)
    sums = np.stack([np.concatenate([[0.0], np.cumsum(series)]) for series in (before, after)])
    random = np.random.default_rng(seed)
    starts = random.integers(0, len(before) - length + 1, (settings.resamples, 2 * settings.blocks))
    means = (sums[:, starts + length] - sums[:, starts]).sum(axis=-1) / (length * 2 * settings.blocks)
    drawn = [ratio(b, a) for b, a in means.T]
    low, high = np.quantile(drawn, [0.05, 0.95])
    return value, (float(min(low, value)), float(max(high, value)))


def shares(linearized: Linearized, scored: FittedHypothesis) -> list[float]:
    """Shapley shares of the effects of an explanation in its reduction, coefficients as fitted."""
    candidate, solution = scored.candidate, scored.solution
    assert candidate is not None
    count = len(candidate.members)
    if count == 1:
        return [1.0]
    parts = candidate.slices()

    @cache
    def taken_off(members: tuple[int, ...]) -> float:
        simulated = linearized.simulate(solution.z)
        if members:
            subset = type(candidate)(tuple(candidate.members[i] for i in members))
            with suppress(InputError):  # an effect that cannot stand without another one of them
                simulated = linearized.simulate(
                    solution.z, subset.unknowns(), np.concatenate([solution.x[parts[i]] for i in members])
                )
        return -float(np.sum((linearized.measured - simulated) ** 2))

    values = np.zeros(count)
    for i in range(count):
        others = [j for j in range(count) if j != i]
        for size in range(count):
            for subset in combinations(others, size):
                weight = factorial(size) * factorial(count - size - 1) / factorial(count)
                values[i] += weight * (taken_off(tuple(sorted((*subset, i)))) - taken_off(subset))
    values = np.maximum(values, 0.0)
    return list(values / values.sum()) if values.sum() > 0 else [1.0 / count] * count
