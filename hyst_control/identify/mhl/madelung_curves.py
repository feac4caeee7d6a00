# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Parametrized curves of Madelung hysteresis: closure in the parameters, monotony as linear inequalities."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.chain.hysteresis.madelung import Madelung
from hyst_control.identify.data.fit import Number

MIN_SLOPE = 5e-3
"""Smallest slope of a curve relative to its mean slope: a curve that rises this much everywhere has an inverse."""

MIN_TRAVEL = 0.02
"""Smallest travel of a curve, of what the measurement travels: without one a search on records that no curve explains ends at no curve."""

GRID = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, 257))
"""Points at which the smallest slope of a polynomial is enforced: closest together at the ends, as its turns are."""


@dataclass(frozen=True)
class Ends:
    """Commands at the ends of the major loop's curves."""

    lower: float  # Command at the lower end, V
    length: float  # Distance of the upper end, V

    @property
    def upper(self) -> float:
        """Command at the upper end, V."""
        return self.lower + self.length


@dataclass(frozen=True)
class Curves:
    """A pair of curves as a parameter vector, in units of the full output: polynomials, or cubics through values at `knots`.

    Polynomials: p_n ... p_1, then q_n ... q_2; q_1 follows from closure. Cubics: the ascending values behind the first knot, then
    the descending ones between the first and the last, where both meet.
    """

    degree: int = 5  # Degree of the polynomials
    # Knots of the cubics, from 0 to 1 of the input scale; None: polynomials
    knots: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        if self.knots is None and not 1 <= self.degree <= 12:
            raise InputError(f"degree: must be from 1 to 12, got {self.degree}")
        if self.knots is not None:
            knots = np.array(self.knots, dtype=float)
            object.__setattr__(self, "knots", tuple(knots.ravel().tolist()))
            if knots.ndim != 1 or len(knots) < 3 or knots[0] != 0 or knots[-1] != 1 or np.any(np.diff(knots) <= 0):
                raise InputError(f"knots: must be at least three, strictly increasing from 0 to 1, got {knots.ravel().tolist()}")

    @property
    def count(self) -> int:
        """Parameters of the ascending curve; the descending one has one fewer."""
        return self.degree if self.knots is None else len(self.knots) - 1

    @property
    def size(self) -> int:
        """Number of parameters."""
        return 2 * self.count - 1

    @cached_property
    def maps(self) -> tuple[Array, Array, Array]:
        """Matrices from a vector to both curves in the stage's form, and the row (size,) to the output at the upper end."""
        up, down = np.eye(self.size)[: self.count], np.eye(self.size)[self.count :]
        if self.knots is None:
            full = up.sum(axis=0)
            return up, np.vstack([down, full - down.sum(axis=0)]), full
        zero = np.zeros((1, self.size))
        return np.vstack([zero, up]), np.vstack([zero, down, up[-1]]), up[-1]

    def full(self, vector: Annotated[Array, "P"]) -> float:
        """Output at the upper end."""
        return float(self.maps[2] @ vector[: self.size])

    def pair(self, vector: Annotated[Array, "P"]) -> tuple[Array, Array]:
        """Ascending and descending curve in the stage's form, scaled to end at 1."""
        up, down, full = (each @ vector[: self.size] for each in self.maps)
        return up / full, down / full

    def stage(self, vector: Annotated[Array, "P"], ends: Ends, output_scale: float, inverse: bool = False) -> Madelung:
        """Construct the stage of a parameter vector."""
        up, down = self.pair(vector)
        return Madelung(up, down, ends.length, output_scale * self.full(vector), self.knots, inverse, ends.lower)

    def like(self, other: Curves, vector: Array) -> Annotated[Array, "P"]:
        """Convert the parameters of curves of another form: polynomials of no higher degree, or evaluated at the knots."""
        up, down = other.pair(vector)
        full = other.full(vector)
        if self.knots is not None:
            values = [full * np.polyval(np.append(p, 0.0), self.knots) for p in (up, down)]
            return np.concatenate([values[0][1:], values[1][1:-1]])
        pad = np.zeros(self.degree - other.degree)
        return full * np.concatenate([pad, up, pad, down[:-1]])

    def start(self, bulge: float = 0.15) -> Annotated[Array, "P"]:
        """Initial parameters: parabolas x (1 ± bulge (1 - x)), the ascending one below."""
        if self.knots is not None:
            x = np.asarray(self.knots, dtype=float)
            return np.concatenate([(x - bulge * x * (1 - x))[1:], (x + bulge * x * (1 - x))[1:-1]])
        if self.degree == 1:
            return np.ones(1)
        up, down = np.zeros(self.degree), np.zeros(self.degree)
        up[-2:], down[-2:] = (bulge, 1.0 - bulge), (-bulge, 1.0 + bulge)
        return np.concatenate([up, down[:-1]])

    def constraints(self) -> tuple[Array, Array]:
        """Constraints lhs (C, size) · vector >= rhs (C,) under which both curves rise, and go up by `MIN_TRAVEL`."""
        *curves, travel = self.maps
        if self.knots is None:
            powers = np.arange(self.degree, 0, -1)
            rise = powers * GRID[:, None] ** (powers - 1)
        else:
            rise = np.diff(np.eye(len(self.knots)), axis=0) / np.diff(self.knots)[:, None]
        rising = np.concatenate([rise @ curve for curve in curves]) - MIN_SLOPE * travel
        return np.vstack([rising, travel]), np.append(np.zeros(len(rising)), MIN_TRAVEL)

    def numbers(self, vector: Annotated[Array, "P"]) -> list[Number]:
        """Coefficients of both curves."""
        pairs = zip(("ascending", "descending"), self.pair(vector), strict=True)
        return [Number(f"{name}[{i}]", value) for name, values in pairs for i, value in enumerate(values)]

    def tolerance(self, vector: Annotated[Array, "P"], covariance: Annotated[Array, "P P"]) -> dict[str, float]:
        """Tolerance of the curves as a whole: coefficients of a polynomial are known together far better than one by one.

        It is the relative error which, drawn independently per coefficient, scatters the curves as much as the data leave them uncertain.
        """
        nominal = np.concatenate(self.pair(vector))
        moved = [np.concatenate(self.pair(vector + 1e-6 * unit)) for unit in np.eye(self.size)]
        jacobian = (np.array(moved) - nominal).T / 1e-6
        spread = jacobian @ covariance[: self.size, : self.size] @ jacobian.T
        if self.knots is None:
            half = len(nominal) // 2
            basis = GRID[:, None] ** np.arange(half, 0, -1)
            parts = (slice(0, half), slice(half, None))
            certain = sum(np.trace(basis @ spread[part, part] @ basis.T) for part in parts)
            found = float(np.sqrt(max(certain, 0.0) / sum(np.sum((basis * nominal[part]) ** 2) for part in parts)))
        else:
            used = nominal > 0
            found = float(np.sqrt(np.mean(np.maximum(np.diag(spread), 0.0)[used] / nominal[used] ** 2)))
        return {"ascending": found, "descending": found}
