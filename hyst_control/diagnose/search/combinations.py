# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Combinations of effects as sums of single ones, of which none needs to lead alone.

Two effects of like size each leave what the other does, and a third one that is neither may leave less. So the changes of the output by
effects at their starts are laid side by side, with the derivatives by their parameters: to first order the output of a combination is the
sum, and what it leaves follows from one matrix of scalar products. The best are fitted.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.base.parallel import map_known
from hyst_control.diagnose.search.candidate import Candidate, Member
from hyst_control.diagnose.search.fit import Linearized, effect_columns, is_bounded

OFTEN = 3  # Combinations that an effect which does not lead by itself may be in


@dataclass(frozen=True)
class Tangent:
    """Effects at values of their parameters: what they add to the output there (M,), and its derivatives (M, P)."""

    candidate: Candidate
    values: Array
    added: Array
    columns: Array


def tangents_of_starts(linearized: Linearized, members: Sequence[Member], most: int) -> list[Tangent]:
    """Tangents of every effect at some of its starts, those left out that cannot be simulated."""
    wanted = []
    for member in members:
        candidate, starts = Candidate((member,)), member.starts()
        chosen = np.unique(np.linspace(0, len(starts) - 1, min(most, len(starts))).astype(int))
        wanted += [(candidate, starts[index]) for index in chosen]
    return tangents_at(linearized, wanted)


def tangents_at(linearized: Linearized, wanted: Sequence[tuple[Candidate, Array]]) -> list[Tangent]:
    """Tangents of effects at values of their parameters, those left out that cannot be simulated."""
    found = map_known(_tangent, [(linearized, candidate, values) for candidate, values in wanted])
    return [Tangent(candidate, *one) for (candidate, _), one in zip(wanted, found, strict=True) if one is not None]


def closest_combinations(
    linearized: Linearized, some: Sequence[Tangent], effects: Sequence[Tangent], count: int, leading: Collection[str] = ()
) -> list[tuple[Candidate, Array]]:
    """Find the combinations of one of `some` and a further effect that come closest to the records, and where to begin their fits."""
    tangents = list({id(one): one for one in (*some, *effects)}.values())
    if not tangents:
        return []
    edges = np.cumsum([0, *(1 + one.columns.shape[1] for one in tangents)])
    gap = linearized.measured - linearized.nominal
    parts = [part for one in tangents for part in (one.added[:, None], one.columns)]
    products = linearized.unexplained_products(*parts, gap[:, None])
    gram, right, energy = products[:-1, :-1], products[:-1, -1], float(products[-1, -1])
    weight, each = linearized.problem.weight, float(np.log(len(gap))) / linearized.problem.weight
    begins = {id(one): int(edges[i]) for i, one in enumerate(tangents)}
    pairs = [(one, other) for one in some for other in effects if _may_act_together(one.candidate, other.candidate)]
    ends: list[tuple[float, Array]] = [(np.inf, np.zeros(0))] * len(pairs)
    shapes = np.array([(one.columns.shape[1], other.columns.shape[1]) for one, other in pairs]).reshape(-1, 2)
    for shape in np.unique(shapes, axis=0):
        alike = np.flatnonzero(np.all(shapes == shape, axis=1))
        added = np.array([[begins[id(one)], begins[id(other)]] for one, other in (pairs[k] for k in alike)])
        for k, end in zip(alike, _after_steps(gram, right, energy, added, shape, weight), strict=True):
            ends[k] = end
    best: dict[frozenset[object], tuple[float, Tangent, Tangent, Array]] = {}
    for (one, other), (left, step) in zip(pairs, ends, strict=True):
        # A combination of many parameters comes closer by chance: Schwarz's criterion (1978).
        left += each * len(step)
        names = frozenset(known.variant for tangent in (one, other) for known in tangent.candidate.members)
        if names not in best or left < best[names][0]:
            best[names] = left, one, other, step
    met, chosen = Counter[str](), list[tuple[Candidate, Array]]()
    for _, one, other, step in sorted(best.values(), key=lambda item: item[0]):
        every = {member.name for tangent in (one, other) for member in tangent.candidate.members}
        # Otherwise effects that do nearly the same take all places, each of them with every partner.
        if len(chosen) < count and all(met[name] < OFTEN for name in every.difference(leading)):
            met.update(every)
            chosen.append(_combined(one, other, step))
    return chosen


def _tangent(linearized: Linearized, candidate: Candidate, values: Array) -> tuple[Array, Array, Array] | None:
    """A tangent without its effects, which no process can send back; None where it cannot be simulated."""
    unknowns, nominal = candidate.unknowns(), np.zeros(linearized.count)
    x = np.clip(values, unknowns.lower, unknowns.upper)
    try:
        there = linearized.simulate(nominal, unknowns, x)
        if is_bounded(there):
            return x, there - linearized.nominal, effect_columns(linearized, unknowns, nominal, x, there)
    except InputError:
        pass
    return None


def _may_act_together(one: Candidate, other: Candidate) -> bool:
    (member,) = other.members
    return not any(member.variant == known.variant or known.excludes(member) for known in one.members)


def _after_steps(
    gram: Array, right: Array, energy: float, added: Annotated[Array, "B 2"], parameters: Sequence[int], weight: float
) -> Iterator[tuple[float, Array]]:
    """Squared size of what each pair of tangents leaves after a step in their parameters, and this step.

    added: numbers of the columns that the two of each pair add; their derivatives by so many parameters follow there.
    """
    columns = np.concatenate([added[:, [k]] + 1 + np.arange(count) for k, count in enumerate(parameters)], axis=1)
    before = energy - 2.0 * right[added].sum(axis=1) + gram[added[:, :, None], added[:, None, :]].sum(axis=(1, 2))
    slopes = right[columns] - gram[columns[:, :, None], added[:, None, :]].sum(axis=2)
    inner = gram[columns[:, :, None], columns[:, None, :]] + np.eye(columns.shape[1]) / weight
    steps = np.linalg.solve(inner, slopes[:, :, None])[:, :, 0]
    for left, slope, step in zip(before.tolist(), slopes, steps, strict=True):
        yield left - float(slope @ step), step


def _combined(one: Tangent, other: Tangent, step: Array) -> tuple[Candidate, Array]:
    (member,) = other.candidate.members
    both = one.candidate.with_member(member)
    size = len(one.values)
    moved = one.values + step[:size]
    values = {id(known): moved[place] for known, place in zip(one.candidate.members, one.candidate.slices(), strict=True)}
    values[id(member)] = other.values + step[size:]
    unknowns = both.unknowns()
    return both, np.clip(np.concatenate([values[id(known)] for known in both.members]), unknowns.lower, unknowns.upper)
