# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Pairs of effects as sums of single ones, of which neither needs to lead alone.

A beam search adds an effect to those that alone do best. Two effects of like size, a drifting gain and a lag say, each leave what the
other does, and a third one that is neither may leave less than either. So the effects are laid side by side: of each the change of the
output at one of its starts and the derivatives by its parameters there. To first order the output of a pair is the sum of both, and
what every pair leaves follows from one matrix of scalar products, coefficients marginalised. The best are fitted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.base.parallel import map_known
from hyst_control.diagnose.search.candidate import Candidate, Member
from hyst_control.diagnose.search.fit import Linearized, effect_columns, is_bounded


@dataclass(frozen=True)
class Tangent:
    """An effect at one of its starts: what it adds to the output there (M,), and its derivatives (M, P)."""

    member: Member
    start: Array
    added: Array
    columns: Array


def joint_pairs(linearized: Linearized, members: Sequence[Member], count: int, starts: int) -> list[tuple[Candidate, Array]]:
    """Find the pairs of effects that together come closest to the records, to first order."""
    fitted = [member for member in members if member.size]
    found = map_known(_tangents, [(linearized, member, starts) for member in fitted])
    tangents = [Tangent(member, *one) for member, each in zip(fitted, found, strict=True) for one in each]
    if len(tangents) < 2:
        return []
    blocks = np.hstack([np.column_stack([one.added, one.columns]) for one in tangents])
    edges = np.cumsum([0, *(1 + one.columns.shape[1] for one in tangents)])
    gap = linearized.measured - linearized.nominal
    known = linearized.unexplained(blocks)
    gram, right, energy = blocks.T @ known, known.T @ gap, float(gap @ linearized.unexplained(gap))
    each = float(np.log(len(gap))) / linearized.problem.weight
    best: dict[frozenset[object], tuple[float, int, int, Array]] = {}
    for a, one in enumerate(tangents):
        for b in range(a + 1, len(tangents)):
            other = tangents[b]
            if one.member.variant == other.member.variant or one.member.excludes(other.member):
                continue
            left, step = _after_step(
                gram, right, energy, (edges[a], edges[a + 1]), (edges[b], edges[b + 1]), linearized.problem.weight
            )
            # A pair of many parameters comes closer by chance: Schwarz's criterion (1978).
            left += each * len(step)
            pair = frozenset((one.member.variant, other.member.variant))
            if pair not in best or left < best[pair][0]:
                best[pair] = left, a, b, step
    chosen = sorted(best.values(), key=lambda item: item[0])[:count]
    return [_pair(tangents[a], tangents[b], step) for _, a, b, step in chosen]


def _tangents(linearized: Linearized, member: Member, most: int) -> list[tuple[Array, Array, Array]]:
    """Tangents of an effect at some of its starts, those left out that cannot be simulated: all of them but the effect."""
    unknowns, nominal, found = Candidate((member,)).unknowns(), np.zeros(linearized.count), []
    begins = member.starts()
    for start in begins[:: -(-len(begins) // most)]:
        x = np.clip(start, unknowns.lower, unknowns.upper)
        try:
            there = linearized.simulate(nominal, unknowns, x)
            if is_bounded(there):
                found.append((x, there - linearized.nominal, effect_columns(linearized, unknowns, nominal, x, there)))
        except InputError:
            continue
    return found


def _after_step(
    gram: Array, right: Array, energy: float, one: tuple[int, int], other: tuple[int, int], weight: float
) -> tuple[float, Array]:
    """Squared size of what a pair of tangents leaves after a step in their parameters, and this step."""
    added = [one[0], other[0]]
    columns = [*range(one[0] + 1, one[1]), *range(other[0] + 1, other[1])]
    before = energy - 2.0 * float(right[added].sum()) + float(gram[np.ix_(added, added)].sum())
    slope = right[columns] - gram[np.ix_(columns, added)].sum(axis=1)
    step = np.linalg.solve(gram[np.ix_(columns, columns)] + np.eye(len(columns)) / weight, slope)
    return before - float(slope @ step), step


def _pair(one: Tangent, other: Tangent, step: Array) -> tuple[Candidate, Array]:
    pair = Candidate((one.member,)).with_member(other.member)
    parts = {id(one.member): one.start + step[: len(one.start)], id(other.member): other.start + step[len(one.start) :]}
    unknowns = pair.unknowns()
    return pair, np.clip(np.concatenate([parts[id(member)] for member in pair.members]), unknowns.lower, unknowns.upper)
