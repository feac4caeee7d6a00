# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Fits of candidates: points to begin at, and the fits themselves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.base.parallel import map_known
from hyst_control.diagnose.configuration import SearchSettings
from hyst_control.diagnose.search.candidate import Candidate, Member
from hyst_control.diagnose.search.fit import LENGTHS, MIN_APPROACH, Linearized, Solution, Unknowns, effect_columns, fit, is_bounded

FAR = 4.0
"""Misfit of a start, in those without the effect, from which the effect is far larger there than what it could explain."""


@dataclass(frozen=True)
class Begun:
    """A candidate fitted beside linear coefficients."""

    candidate: Candidate  # Effects that are fitted together
    ends: tuple[Solution, ...]  # Where its best starts lead, best first; at least one

    @property
    def misfit(self) -> float:
        """Of the best end, nats."""
        return self.ends[0].misfit


def begin(
    linearized: Linearized, candidates: Sequence[tuple[Candidate, Sequence[Array]]], settings: SearchSettings, rival: float = np.inf
) -> list[Begun]:
    """Fit candidates beside linear coefficients: what the search goes by, until a fit of the chain as it is could matter.

    Each has to come below a rival, the misfit without it.
    """
    order = sorted(range(len(candidates)), key=lambda i: -len(candidates[i][1]) * len(candidates[i][1][0]))  # the longest first
    stepped = map_known(_first_steps, [(linearized, *candidates[i], settings, rival) for i in order])
    found = {i: ends for i, ends in zip(order, stepped, strict=True) if ends}

    def go_on(chosen: Sequence[int], rival: float) -> None:
        running = [i for i in chosen if any(_may_reach(one, rival) for one in found[i])]
        ends = map_known(_continued, [(linearized, candidates[i][0], found[i], rival) for i in running])
        found.update(zip(running, ends, strict=True))

    first = _first(found, [candidate for candidate, _ in candidates], settings.first)
    go_on(first, rival)
    if first:
        misfits = [found[i][0].misfit for i in first]
        go_on([i for i in found if i not in first], min(rival, max(within(min(misfits), rival, settings), *misfits)))
    return sorted((Begun(candidates[i][0], tuple(found[i])) for i in sorted(found)), key=lambda one: one.misfit)


def within(best: float, without: float, settings: SearchSettings) -> float:
    """Misfit up to which a fit beside linear coefficients may be as good as the best."""
    return best + max(settings.slack * (without - best), settings.near)


def _first(found: Mapping[int, Sequence[Solution]], candidates: Sequence[Candidate], count: int) -> list[int]:
    """The candidates that lead after one step, of every explanation its best realization."""
    best: dict[tuple[object, ...], int] = {}
    for i in sorted(found, key=lambda i: found[i][0].misfit):
        best.setdefault(tuple(member.variant for member in candidates[i].members), i)
    return list(best.values())[:count]


def _first_steps(
    linearized: Linearized, candidate: Candidate, starts: Sequence[Array], settings: SearchSettings, rival: float
) -> list[Solution]:
    """The most promising starts after one step, the coefficients' columns as they are: best first."""
    unknowns = candidate.unknowns()
    if len(candidate.members) == 1:
        starts = _nearby(linearized, unknowns, candidate.members[0], starts, settings.scanned)
    if len(starts) > settings.screened and len(starts[0]) > 2:
        starts = _promising(linearized, candidate, unknowns, starts, settings)
    elif len(starts) > 1:
        nominal = misfit_of(linearized, linearized.measured - linearized.nominal)
        starts = _near(linearized, unknowns, starts, nominal)[: 2 * settings.followed]
    stepped: list[Solution] = []
    for start in starts:
        with suppress(InputError):
            stepped.append(fit(linearized, unknowns, start, rounds=1, rival=rival, linear=True))
    return sorted(stepped, key=lambda one: one.misfit)[: settings.followed]


def _continued(linearized: Linearized, candidate: Candidate, ends: Sequence[Solution], rival: float) -> list[Solution]:
    """Fits gone on with while they may come below a rival, and below one another: best first."""
    unknowns, found = candidate.unknowns(), list[Solution]()
    for one in ends:
        if _may_reach(one, rival):
            with suppress(InputError):
                one = fit(linearized, unknowns, one.x, rival=rival, linear=True)
        found.append(one)
        rival = min(rival, one.misfit)
    return sorted(found, key=lambda one: one.misfit)


def _may_reach(one: Solution, rival: float) -> bool:
    """Check that going on with a fit may bring it to the misfit of a rival."""
    return one.remaining > max(0.0, MIN_APPROACH * (one.misfit - rival))


def _promising(
    linearized: Linearized, candidate: Candidate, unknowns: Unknowns, starts: Sequence[Array], settings: SearchSettings
) -> list[Array]:
    """Of many starts, a scan over frequencies, the ends of the most promising linear steps."""
    if not candidate.members[0].is_linear:
        starts = best_scaled(linearized, unknowns, starts, settings.screened)
    ranked: list[tuple[float, int, Array]] = []
    for start in starts:
        with suppress(InputError):
            left, there = _after_step(linearized, unknowns, candidate, start, settings)
            ranked.append((left, len(ranked), there))
    return [start for *_, start in sorted(ranked, key=lambda item: item[:2])[: settings.followed]]


def _near(linearized: Linearized, unknowns: Unknowns, starts: Sequence[Array], misfit: float) -> list[Array]:
    """Starts whose misfit is at most `FAR` times that without the effect, closest first; the closest one is always among them."""
    misfits = [misfit_at(linearized, unknowns, start) for start in starts]
    nearest, *others = sorted(range(len(starts)), key=misfits.__getitem__)
    return [starts[nearest], *(starts[i] for i in others if misfits[i] <= FAR * misfit)]


def best_scaled(linearized: Linearized, unknowns: Unknowns, starts: Sequence[Array], count: int) -> list[Array]:
    """Of many starts, a scan over frequencies, those at which the effect explains most, whatever its size."""
    gap = linearized.measured - linearized.nominal

    def explained(start: Array) -> float:
        try:
            change = linearized.simulate(np.zeros(linearized.count), unknowns, start) - linearized.nominal
        except InputError:
            return 0.0
        if not is_bounded(change):
            return 0.0
        (own, along), _ = linearized.unexplained_products(np.column_stack([change, gap]))
        return float(along**2 / own) if own > 0.0 else 0.0

    return sorted(starts, key=explained, reverse=True)[:count]


def misfit_at(linearized: Linearized, unknowns: Unknowns, start: Array) -> float:
    """Misfit of an effect as it is, coefficients marginalized about the nominal ones; infinite where it cannot be simulated."""
    try:
        return misfit_of(linearized, linearized.measured - linearized.simulate(np.zeros(linearized.count), unknowns, start))
    except InputError:
        return np.inf


def gone_on(linearized: Linearized, begun: Begun, rival: float) -> Solution:
    """The best of the fits that were begun, each gone on with while it may reach the best other one.

    One that promises less than the other leaves is not stopped on its way, however far behind its coefficients begin.
    """
    unknowns = begun.candidate.unknowns()
    ends: list[Solution] = []
    for solution in begun.ends:
        behind = rival if solution.misfit > rival else np.inf
        try:
            ends.append(fit(linearized, unknowns, solution.x, _possible(linearized, unknowns, solution), rival=behind))
        except InputError:
            continue  # next to the nominal coefficients it could be simulated, but not at these
        rival = min(rival, ends[-1].misfit)
    return min(ends or begun.ends, key=lambda one: one.misfit)


def _possible(linearized: Linearized, unknowns: Unknowns, begun: Solution) -> Array:
    """The coefficients (K,) that a fit beside linear ones promises, as far as the chain follows them."""

    def left(length: float) -> float:
        z = length * begun.z
        try:
            residual = linearized.measured - linearized.simulate(z, unknowns, begun.x)
        except InputError:
            return np.inf
        return 0.5 * float(linearized.problem.weight * (residual @ residual) + z @ z) if is_bounded(residual) else np.inf

    if left(1.0) <= 2.0 * begun.misfit:
        return begun.z
    return min((1.0, *LENGTHS[1:], 0.0), key=left) * begun.z


def _nearby(linearized: Linearized, unknowns: Unknowns, member: Member, starts: Sequence[Array], count: int) -> Sequence[Array]:
    """Starts of a member, of a suggested parameter replaced by the value near them that comes closest to the record."""
    index = next((i for i, parameter in enumerate(member.parameters) if parameter.suggested), None)
    if index is None:
        return starts
    lower, upper = unknowns.lower[index], unknowns.upper[index]
    span = np.ptp(np.concatenate([piece.command for piece in member.problem.pieces])) / member.parameters[index].scale

    def at(start: Array, value: float) -> Array:
        x = start.copy()
        x[index] = np.clip(value, lower, upper)
        return x

    # Its misfit has a narrow minimum without a slope around: a scan over the width that a spectrum leaves, and two around the best value.
    scanned = [
        (misfit_at(linearized, unknowns, at(start, value)), value, start)
        for start in starts
        for value in start[index] + 0.75 * start[index] ** 2 / span * np.linspace(-1.0, 1.0, 2 * count + 1)
    ]
    _, best, start = min(scanned, key=lambda item: item[0])
    width = 0.75 * start[index] ** 2 / span / count
    for _ in range(2):
        values = best + width * np.linspace(-1.0, 1.0, count + 1)
        best = float(values[int(np.argmin([misfit_at(linearized, unknowns, at(start, value)) for value in values]))])
        width *= 2.0 / count
    return [at(start, best)]


def _after_step(
    linearized: Linearized, unknowns: Unknowns, candidate: Candidate, x: Array, settings: SearchSettings
) -> tuple[float, Array]:
    """Misfit after a linear step in the first effect's parameters from x, coefficients marginalized, and where it leads."""
    nominal = np.zeros(linearized.count)
    simulated = linearized.simulate(nominal, unknowns, x)
    residual = linearized.measured - simulated
    member, chosen = candidate.members[0], list(range(candidate.members[0].size))
    if len(member.parameters) == len(chosen) and len(member.starts()) > settings.screened:
        # Many starts over frequencies say enough of those; the amplitudes are what a step can find.
        chosen = [i for i, p in zip(chosen, member.parameters, strict=True) if not p.logarithmic]
    if not is_bounded(residual):
        raise InputError("the chain grows without limit at these values")
    design = effect_columns(linearized, unknowns, nominal, x, simulated, chosen=chosen)
    products, weight = linearized.unexplained_products(np.column_stack([design, residual])), linearized.problem.weight
    normal, right, energy = products[:-1, :-1], products[:-1, -1], float(products[-1, -1])
    there = x.copy()
    step = np.linalg.solve(normal + np.eye(len(right)) / weight, right)
    there[chosen] = np.clip(x[chosen] + step, unknowns.lower[chosen], unknowns.upper[chosen])
    return 0.5 * weight * (energy - float(right @ step)), there


def misfit_of(linearized: Linearized, residual: Annotated[Array, "N"]) -> float:
    """Half the squared size of a residual, coefficients marginalized."""
    if not is_bounded(residual):
        return np.inf
    return 0.5 * linearized.problem.weight * float(linearized.unexplained_products(residual[:, None])[0, 0])
