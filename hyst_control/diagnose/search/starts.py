# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Fits of candidates: points to begin at, the fits themselves, and the candidates that one more effect makes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.base.parallel import map_forked
from hyst_control.diagnose.configuration import SearchSettings
from hyst_control.diagnose.search.candidate import Candidate, Member
from hyst_control.diagnose.search.fit import LENGTHS, Linearized, Solution, Unknowns, fit, is_bounded
from hyst_control.diagnose.search.tangents import Tangents

FEW = 2
"""Parameters up to which fits begin at the starts themselves too."""


@dataclass(frozen=True)
class Begun:
    """A candidate fitted beside linear coefficients."""

    candidate: Candidate  # Effects that are fitted together
    ends: tuple[Solution, ...]  # Where its best starts lead, best first; at least one

    @property
    def misfit(self) -> float:
        """Of the best end, nats."""
        return self.ends[0].misfit


def begin(linearized: Linearized, candidates: Sequence[tuple[Candidate, Sequence[Array]]], settings: SearchSettings) -> list[Begun]:
    """Fit candidates beside linear coefficients: what the search goes by, until a fit of the chain as it is could matter."""
    ends = map_forked(lambda i: _ends(linearized, *candidates[i], settings.followed), len(candidates))
    return _sorted([(candidate, one) for (candidate, _), one in zip(candidates, ends, strict=True)])


def begin_alone(tangents: Tangents, threshold: float, settings: SearchSettings) -> list[Begun]:
    """Fit single effects in the same way, from the starts that a linear step makes most of; one that promises nothing is not fitted."""
    members, before, weight = tangents.members, tangents.nominal_misfit, tangents.linearized.problem.weight
    energy = tangents.energy
    steps = [[one.step(one.right, energy, weight) for one in tangents.of(member)] for member in members]
    best = min((left for each in steps for left, _ in each), default=before)
    # Beside a great gap no tangent holds: what promises little may still explain it.
    limit = before - settings.promise * threshold if before - best < threshold else np.inf

    def ends(i: int) -> list[Solution]:
        return _ends_alone(tangents, members[i], steps[i], limit, settings)

    found = map_forked(ends, len(members))
    return _sorted([(Candidate((member,)), one) for member, one in zip(members, found, strict=True)])


def _sorted(found: Sequence[tuple[Candidate, Sequence[Solution]]]) -> list[Begun]:
    return sorted((Begun(candidate, tuple(ends)) for candidate, ends in found if ends), key=lambda one: one.misfit)


def finish(linearized: Linearized, begun: Sequence[Begun], rival: float) -> list[tuple[Candidate, Solution]]:
    """Fit candidates from where they were begun, the chain with all its coefficients as it is."""
    found = map_forked(lambda i: _gone_on(linearized, begun[i], rival), len(begun))
    return [(one.candidate, solution) for one, solution in zip(begun, found, strict=True)]


def _ends_alone(
    tangents: Tangents, member: Member, steps: Sequence[tuple[float, Array]], limit: float, settings: SearchSettings
) -> list[Solution]:
    """Fits of an effect, begun where its tangents lead, and best first."""
    linearized, candidate, every = tangents.linearized, Candidate((member,)), tangents.of(member)
    if any(parameter.suggested for parameter in member.parameters):
        starts = _nearby(linearized, candidate.unknowns(), member, member.starts(), settings.scanned)
        return _ends(linearized, candidate, starts, settings.followed)
    if not every:
        return []
    before, weight = tangents.nominal_misfit, linearized.problem.weight
    at_start = [one.misfit(tangents.energy, weight) for one in every]
    order = sorted(range(len(every)), key=lambda i: steps[i][0])
    promised, nearest = steps[order[0]][0], int(np.argmin(at_start))
    if promised > limit:
        there = steps[order[0]][1] if promised < at_start[nearest] else every[nearest].start
        if min(promised, at_start[nearest]) <= 2.0 * before - limit:
            return _ends(
                linearized, candidate, [there], 1, rounds=0
            )  # tangents that lead to the nominal model hold: nothing to gain
        return _ends(linearized, candidate, [steps[order[0]][1], every[nearest].start], settings.followed, rival=limit)
    starts = [one.start for one in every]
    if len(starts) > settings.followed:
        leading = [steps[i][1] for i in order[: settings.followed]]
        if member.size == 1:
            # Of one parameter a linear step may promise too much from afar.
            starts = [*leading, every[nearest].start]
        elif member.size <= FEW:
            # Beside a great gap the first step, in all coefficients too, may lead to the end of a range: begin where the starts are too.
            starts = [*leading, *starts]
        else:
            starts = leading
    return _ends(linearized, candidate, starts, settings.followed)


def _ends(
    linearized: Linearized, candidate: Candidate, starts: Sequence[Array], most: int, rival: float = np.inf, rounds: int = 8
) -> list[Solution]:
    """Fits from these starts, the coefficients' columns as they are: best first."""
    unknowns, tried = candidate.unknowns(), list[Solution]()
    for start in starts:
        nearest = min((rival, *(one.misfit for one in tried)))
        try:
            tried.append(fit(linearized, unknowns, start, rounds=rounds, rival=nearest, linear=True))
        except InputError:
            continue
    return sorted(tried, key=lambda one: one.misfit)[:most]


def _gone_on(linearized: Linearized, begun: Begun, rival: float) -> Solution:
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
    """The coefficients (K,) that a fit beside linear ones promises, as far as the chain follows them: beside a great gap they may be
    many tolerances away."""

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
    """Starts of a member, of a suggested parameter replaced by the value near them that comes closest to the record.

    The misfit of such a parameter has a narrow minimum without a slope around it: a scan over the width that a spectrum leaves, and two
    more around its best value.
    """
    index = next((i for i, parameter in enumerate(member.parameters) if parameter.suggested), None)
    if index is None:
        return starts
    lower, upper = unknowns.lower[index], unknowns.upper[index]
    nominal = np.zeros(linearized.count)
    span = np.ptp(np.concatenate([piece.command for piece in member.problem.pieces])) / member.parameters[index].scale

    def left(start: Array, value: float) -> float:
        x = start.copy()
        x[index] = np.clip(value, lower, upper)
        try:
            return misfit_of(linearized, linearized.measured - linearized.simulate(nominal, unknowns, x))
        except InputError:
            return np.inf

    scanned = [
        (left(start, value), value, start)
        for start in starts
        for value in start[index] + 0.75 * start[index] ** 2 / span * np.linspace(-1.0, 1.0, 2 * count + 1)
    ]
    _, best, start = min(scanned, key=lambda item: item[0])
    width = 0.75 * start[index] ** 2 / span / count
    for _ in range(2):
        values = best + width * np.linspace(-1.0, 1.0, count + 1)
        best = float(values[int(np.argmin([left(start, value) for value in values]))])
        width *= 2.0 / count
    nearest = start.copy()
    nearest[index] = np.clip(best, lower, upper)
    return [nearest]


def promising_pairs(
    tangents: Tangents, candidate: Candidate, solution: Solution, least: float, most: int
) -> list[tuple[int, Array]]:
    """Find the effects that a linear step on top of a candidate makes most of: what an effect changes adds to what the candidate does."""
    found: dict[tuple[object, ...], tuple[float, int, Array]] = {}
    linearized = tangents.linearized
    weight, nominal = linearized.problem.weight, np.zeros(linearized.count)
    energy, products = tangents.toward(linearized.measured - linearized.simulate(nominal, candidate.unknowns(), solution.x))
    before, index = 0.5 * weight * energy, {id(member): i for i, member in enumerate(tangents.members)}
    for one, right in zip(tangents.every, products, strict=True):
        if any(one.member.excludes(other) for other in candidate.members):
            continue
        left, there = one.step(right, energy, weight)
        if before - left > max(least, found.get(one.member.variant, (-np.inf,))[0]):
            found[one.member.variant] = before - left, index[id(one.member)], there
    return [(place, start) for _, place, start in sorted(found.values(), key=lambda item: -item[0])[:most]]


def misfit_of(linearized: Linearized, residual: Annotated[Array, "N"]) -> float:
    """Half the squared size of a residual, coefficients marginalized."""
    if not is_bounded(residual):
        return np.inf
    return 0.5 * linearized.problem.weight * float(linearized.unexplained_products(residual[:, None])[0, 0])


def merged_start(
    pair: Candidate, candidate: Candidate, x: Annotated[Array, "P"], member: Member, start: Annotated[Array, "Q"]
) -> Array:
    """Join the parameters of a candidate and the start of the effect that is added to it."""
    parts = iter(zip(candidate.members, candidate.slices(), strict=True))
    return np.concatenate([start if one is member else x[next(parts)[1]] for one in pair.members])
