# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Distortion tests of the effects that are named: whether their size would have to change with something else.

An effect whose size has to change with the level, with time, with the rate or with the direction of the command is not that effect. Let
g be what an effect of the explanation adds to the simulation, s a variable scaled to -1 … 1, and P the projection that takes off what
the coefficients and the parameters of all effects could still explain. The distortion c = s g then explains of the residual r

    statistic = ½ w (cᵀ P r)² / (cᵀ P c) nats,    change = 2 (cᵀ P r) / (cᵀ P c),

w the weight of a sample, by what is left with the distortion: where that is most of what the effect leaves, its own correlation is no
reason to believe it less; change is the difference of the effect's size between both ends of the variable, as a share of the size.
Both sums are taken without the stretch of the record that speaks most for the distortion: a clock that slipped once, in the new record
or in the clean one beside it, is in one stretch, and no size that changes.
"""

from __future__ import annotations

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.diagnose.evidence import DistortionEvidence
from hyst_control.diagnose.search.beam_search import FittedHypothesis, effective_sample_weight
from hyst_control.diagnose.search.fit import Linearized, is_bounded

VARIABLES = ("time", "level", "rate", "branch")
MIN_LEFT = 0.1  # Least share of a distortion that coefficients and parameters leave for it to be tested
STRETCHES = 5  # Stretches of the rows, any one of which is left out: a size that changes does so without it too


def distortions(linearized: Linearized, scored: FittedHypothesis, temper: float) -> tuple[DistortionEvidence, ...]:
    """Test the effects of an explanation for distortion."""
    candidate, solution, problem = scored.candidate, scored.solution, linearized.problem
    if candidate is None:
        return ()
    simulated = linearized.measured - solution.residual
    try:
        known = _known(linearized, scored, simulated)
    except InputError:
        return ()  # next to these values the chain cannot be simulated
    weight = temper * problem.weight
    gram = known.T @ known + np.eye(known.shape[1]) / weight
    variables = variables_of(linearized)

    def projected(vector: Array) -> Array:
        return np.asarray(vector - known @ np.linalg.solve(gram, known.T @ vector), dtype=np.float64)

    found = []
    for index, member in enumerate(candidate.members):
        if member.is_line:
            continue
        others = candidate.without(index)
        x = np.delete(solution.x, np.r_[candidate.slices()[index]])
        try:
            absent = linearized.simulate(solution.z, others.unknowns() if others.members else None, x)
        except InputError:
            continue
        added = simulated - absent
        energy = float(added @ added)
        for name, variable in variables.items():
            distorted = variable * added
            left = projected(distorted)
            size = float(distorted @ left)
            if not (is_bounded(distorted) and size > MIN_LEFT * float(distorted @ distorted)):
                continue  # this record cannot tell
            along = float(left @ solution.residual)
            certain = max(temper, effective_sample_weight(problem, solution.residual - along / size * left)) * problem.weight
            along, size = _without_any_stretch(left * solution.residual, distorted * left)
            found.append(
                DistortionEvidence(member.name, name, 2.0 * along / size, 0.5 * certain * along**2 / size, along**2 / size / energy)
            )
    return tuple(found)


def _without_any_stretch(along: Array, size: Array) -> tuple[float, float]:
    """Sums of two products (M,) over all rows but the stretch that speaks most for a change, 0 where it alone does."""
    total, whole = float(along.sum()), float(size.sum())
    least = min(
        ((total - float(one.sum()), whole - float(part.sum())) for one, part in _stretches(along, size)),
        key=lambda rest: np.sign(total) * rest[0] / np.sqrt(max(rest[1], 1e-300)),
    )
    return (least[0] if least[0] * total > 0.0 else 0.0), max(least[1], 1e-300)


def _stretches(*rows: Array) -> list[tuple[Array, ...]]:
    return list(zip(*(np.array_split(one, STRETCHES) for one in rows), strict=True))


def _known(linearized: Linearized, scored: FittedHypothesis, simulated: Array) -> Array:
    """Columns (M, K + P) of the coefficients and of all parameters of an explanation."""
    candidate, solution = scored.candidate, scored.solution
    assert candidate is not None
    unknowns = candidate.unknowns()
    columns = [linearized.columns]
    for p in range(len(solution.x)):
        moved = solution.x.copy()
        moved[p] += unknowns.difference(moved, p)
        column = (linearized.simulate(solution.z, unknowns, moved) - simulated) / (moved[p] - solution.x[p])
        if is_bounded(column):
            columns.append(column[:, None])
    return np.hstack(columns)


def variables_of(linearized: Linearized) -> dict[str, Array]:
    """Variables (M,) by name, each within -1 … 1 on every axis."""
    pieces = linearized.problem.pieces
    low = np.min([piece.command.min(axis=0) for piece in pieces], axis=0)
    high = np.max([piece.command.max(axis=0) for piece in pieces], axis=0)
    rates = [np.gradient(piece.command, axis=0) for piece in pieces]
    usual = np.maximum(np.quantile(np.abs(np.concatenate(rates)), 0.9, axis=0), 1e-300)
    found: dict[str, list[Array]] = {name: [] for name in VARIABLES}
    for piece, rate in zip(pieces, rates, strict=True):
        time = np.linspace(-1.0, 1.0, len(piece.command))[:, None] + 0.0 * rate
        rows = {
            "time": time,
            "level": 2.0 * (piece.command - low) / np.maximum(high - low, 1e-300) - 1.0,
            "rate": 2.0 * np.minimum(np.abs(rate) / usual, 1.0) - 1.0,
            "branch": np.clip(10.0 * rate / usual, -1.0, 1.0),
        }
        for name, values in rows.items():
            found[name].append(piece.counted(values).reshape(-1))
    return {name: np.concatenate(parts) for name, parts in found.items()}
