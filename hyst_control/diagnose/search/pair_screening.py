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

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.diagnose.search.candidate import Candidate
from hyst_control.diagnose.search.tangents import Tangent, Tangents


def joint_pairs(tangents: Tangents, count: int, starts: int) -> list[tuple[Candidate, Array]]:
    """Find the pairs of effects that together come closest to the records, to first order."""
    used = [one for member in tangents.members if member.size for one in _thinned(tangents.of(member), starts)]
    if len(used) < 2:
        return []
    edges = np.cumsum([0, *(len(one.right) for one in used)])
    gram = tangents.products(np.hstack([one.signals for one in used]))
    right, energy, weight = np.concatenate([one.right for one in used]), tangents.energy, tangents.linearized.problem.weight
    each = float(np.log(len(tangents.linearized.measured))) / weight
    best: dict[frozenset[object], tuple[float, int, int, Array]] = {}
    for a, one in enumerate(used):
        for b in range(a + 1, len(used)):
            other = used[b]
            if one.member.variant == other.member.variant or one.member.excludes(other.member):
                continue
            left, step = _after_step(gram, right, energy, (edges[a], edges[a + 1]), (edges[b], edges[b + 1]), weight)
            # A pair of many parameters comes closer by chance: Schwarz's criterion (1978).
            left += each * len(step)
            pair = frozenset((one.member.variant, other.member.variant))
            if pair not in best or left < best[pair][0]:
                best[pair] = left, a, b, step
    chosen = sorted(best.values(), key=lambda item: item[0])[:count]
    return [_pair(used[a], used[b], step) for _, a, b, step in chosen]


def _thinned(tangents: Sequence[Tangent], most: int) -> Sequence[Tangent]:
    return tangents[:: -(-len(tangents) // most)] if tangents else ()


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
    parts, begin = {}, 0
    for tangent in (one, other):
        there, end = tangent.start.copy(), begin + len(tangent.fitted)
        there[list(tangent.fitted)] += step[begin:end]
        parts[id(tangent.member)], begin = there, end
    unknowns = pair.unknowns()
    return pair, np.clip(np.concatenate([parts[id(member)] for member in pair.members]), unknowns.lower, unknowns.upper)
