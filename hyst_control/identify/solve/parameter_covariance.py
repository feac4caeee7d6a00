# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Uncertainty of an identified model: the covariance of a fit's parameters as `uncertainty`, `tolerance` and notes of the model.

A fit works in parameters of its own (slopes of branches, logarithms of rates); the model file states frequencies, dampings, gains,
delays, weights. The covariance is carried from one to the other to first order. A direction in which the data say less than what
anybody knows of such a machine beforehand, a relative `PRIOR` of every number, gets that prior and is named.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.chain import Stage
from hyst_control.chain.coordinates import chain_coordinates

PRIOR = 0.3  # Relative standard deviation of a number that the data cannot tell
STEP = 1e-5  # Difference of neighboring parameters of a fit, which are all of order one unless their own size is given
NAMED = 0.7
"""Parameters that make up an undetermined direction: those that take part with this share of the largest one."""
MAX_NAMED = 4  # Parameters that a note lists
ANY_VALUE = 10.0  # Relative standard deviation from which a number counts as unknown
ROUNDING = 1e-12  # Share of the largest eigenvalue of a Gram matrix of unit columns below which there is rounding alone
DIGITS = 6  # Significant digits of the factor: what correlated numbers need to cancel


@dataclass(frozen=True)
class Uncertainty:
    """Covariance of the numbers of a model."""

    names: tuple[str, ...]  # Names of the P numbers, as in `chain.coordinates`
    parameters: tuple[str, ...]  # Parameter of the model file that each of them is written in
    values: Annotated[Array, "P"]  # Nominal values (P,)
    # Factor (P, P) of the covariance, the symmetric root in units of the prior: column k is mostly number k
    factor: Annotated[Array, "P P"]
    relative: Annotated[Array, "P"]  # Relative standard deviation (P,), PRIOR at most
    data_relative: Array  # The same by the data alone, without the prior
    # Of every direction that the data cannot tell, the names of the numbers that make it up
    undetermined: tuple[tuple[str, ...], ...]

    @property
    def document(self) -> dict[str, Any]:
        """`uncertainty` of a model file; empty without numbers."""
        if not self.names:
            return {}
        return {"parameters": list(self.names), "factor": [[float(f"{value:.{DIGITS}g}") for value in row] for row in self.factor]}

    @property
    def tolerance(self) -> dict[str, float]:
        """`tolerance` of a model file, for readers that know no more: the median relative deviation of every parameter.

        Polynomials have that of the gain and the zeros (`num`), and of the poles (`den`).
        """
        found: dict[str, list[float]] = {}
        for parameter, relative in zip(self.parameters, self.relative.tolist(), strict=True):
            found.setdefault(parameter, []).append(relative)
        return {name: float(f"{np.median(values):.4g}") for name, values in found.items() if any(values)}

    def notes(self, fact: str) -> list[str]:
        """At most one sentence on the numbers that the data cannot tell, with their standard deviations.

        fact: sentence on what the records contain instead.
        """
        spread = dict(zip(self.names, self.data_relative.tolist(), strict=True))

        def told(name: str) -> str:
            return f"{name} (± {100 * spread[name]:.0f} %)" if spread[name] < ANY_VALUE else f"{name} (any value)"

        # A number that is 0 has no relative deviation. Unknown ones come first, in the order of the chain.
        names = [name for name in self.names if spread[name] > 0.0 and any(name in direction for direction in self.undetermined)]
        names.sort(key=lambda name: -min(spread[name], ANY_VALUE))
        if not names:
            return []
        listed, more = ", ".join(map(told, names[:MAX_NAMED])), len(names) - MAX_NAMED
        return [
            f"not identifiable from these records, and assumed to be known to {100 * PRIOR:.0f} %: "
            f"{listed}{f' and {more} more' if more > 0 else ''}. {fact}"
        ]


def uncertainty_of(
    stages_of: Callable[[Array], Sequence[Stage]],
    vector: Annotated[Array, "Q"],
    covariance: Annotated[Array, "Q Q"],
    axes: Sequence[str],
    sizes: Array | None = None,
) -> Uncertainty:
    """Carry the covariance of a fit's parameters over to the numbers of its model."""
    known = chain_coordinates(stages_of(vector), axes)
    steps = STEP * (np.ones(len(vector)) if sizes is None else sizes)

    def values_at(there: Array) -> dict[str, float]:
        return {name: each.value for name, each in chain_coordinates(stages_of(there), axes).items()}

    jacobian = np.nan_to_num(derivatives(values_at, vector, steps))
    moving = [i for i in range(len(known)) if np.any(jacobian[i])]
    names = [list(known)[i] for i in moving]
    values = np.array([known[name].value for name in names])
    spread = jacobian[moving] @ covariance @ jacobian[moving].T
    # A number that is 0 has no size of its own: what the data say is all there is.
    sizes = np.array([known[name].size for name in names])
    scale = np.where(sizes > 0.0, PRIOR * sizes, np.sqrt(np.maximum(np.diag(spread), 1e-300)))
    factor, directions = limited_root(spread / scale[:, None] / scale)
    factor = scale[:, None] * factor
    relative = np.linalg.norm(factor, axis=1) / np.where(sizes > 0.0, sizes, np.inf)
    undetermined = tuple(
        tuple(names[i] for i in np.flatnonzero(np.abs(direction) >= NAMED * np.abs(direction).max())) for direction in directions
    )
    parameters = tuple(known[name].parameter for name in names)
    alone = np.sqrt(np.maximum(np.diag(spread), 0.0)) / np.where(sizes > 0.0, sizes, np.inf)
    return Uncertainty(
        tuple(names), parameters, values, factor, np.minimum(relative, PRIOR), alone, tuple(dict.fromkeys(undetermined))
    )


def limited_root(covariance: Annotated[Array, "P P"]) -> tuple[Array, Array]:
    """Symmetric root of a covariance none of whose directions exceeds variance 1."""
    spectrum, vectors = np.linalg.eigh(covariance)
    limited = np.clip(spectrum, 0.0, 1.0)
    directions = vectors.T[spectrum > 1.0][::-1]
    root: Array = (vectors * np.sqrt(limited)) @ vectors.T
    return root, directions


def untold(gram: Annotated[Array, "K + 1 K + 1"]) -> Annotated[Array, "K K"]:
    """Covariance of the directions that a Gram matrix [columns, target] leaves open, in which residuals scatter nothing.

    Their deviation is what would move the columns as much as the target does.
    """
    power = np.diag(gram)
    scale = np.sqrt(np.maximum(power[:-1], 1e-12 * power[:-1].max()))
    values, vectors = np.linalg.eigh(gram[:-1, :-1] / scale[:, None] / scale)
    open_ = vectors[:, values < ROUNDING * values[-1]] * np.sqrt(power[-1]) / scale[:, None]
    found: Array = open_ @ open_.T
    return found


def derivatives(
    values_at: Callable[[Array], dict[str, float]], vector: Annotated[Array, "Q"], steps: Array
) -> Annotated[Array, "P Q"]:
    """Central differences of named numbers; to one side, or not a number, where a step makes other ones of them."""
    nominal = values_at(vector)
    columns = []
    for step, unit in zip(steps, np.eye(len(vector)), strict=True):
        there = [(sign, values_at(vector + sign * step * unit)) for sign in (1.0, -1.0)]
        changes = [
            sign * np.array([found[name] - value for name, value in nominal.items()])
            for sign, found in there
            if found.keys() == nominal.keys()
        ]
        columns.append(np.mean(changes, axis=0) / step if changes else np.full(len(nominal), np.nan))
    return np.array(columns).reshape(len(vector), len(nominal)).T
