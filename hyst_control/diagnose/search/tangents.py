# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Effects to first order: what each changes at its starts, and its derivatives there, simulated once for all that a search needs.

The null, the choice of starts, and the choice of effects that are added to others follow from scalar products of these signals and of
what is left to explain, coefficients marginalized: with columns J of the coefficients, S = I + w J Jᵀ and w the weight of a sample,

    <a, b> = aᵀ S⁻¹ b = aᵀ b - w (Jᵀ a)ᵀ (I + w Jᵀ J)⁻¹ Jᵀ b

Of records and catalogues too large for memory, signed sums of neighboring rows are kept: products keep their mean, and what is
collinear stays so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.base.parallel import map_forked
from hyst_control.diagnose.search.candidate import Candidate, Member
from hyst_control.diagnose.search.fit import Linearized, effect_columns, is_bounded

MANY = 8
"""Starts beyond which they say enough of parameters on a logarithmic scale, and a step finds the others."""
MAX_VALUES = 40_000_000
"""Numbers that are kept of all effects together."""


@dataclass(frozen=True)
class Tangent:
    """An effect at one of its starts."""

    member: Member
    start: Array  # (P,)
    fitted: tuple[int, ...]  # Parameters that a step goes in, Q of P
    signals: Array  # (m, 1 + Q): what it adds to the output, and its derivatives
    products: Array  # (1 + Q, 1 + Q) of these
    right: Array  # (1 + Q,) of these and the gap of the nominal model

    def step(self, right: Array, energy: float, weight: float) -> tuple[float, Array]:
        """Misfit after a step toward a signal of this energy, `right` its products with these signals, and where the step leads."""
        left = energy - 2.0 * float(right[0]) + float(self.products[0, 0])
        slope = right[1:] - self.products[1:, 0]
        step = np.linalg.solve(self.products[1:, 1:] + np.eye(len(slope)) / weight, slope)
        unknowns, there = Candidate((self.member,)).unknowns(), self.start.copy()
        chosen = list(self.fitted)
        there[chosen] = np.clip(there[chosen] + step, unknowns.lower[chosen], unknowns.upper[chosen])
        return 0.5 * weight * (left - float(slope @ step)), there

    def misfit(self, energy: float, weight: float) -> float:
        """Misfit at the start itself, from the energy of the nominal model's gap."""
        return 0.5 * weight * (energy - 2.0 * float(self.right[0]) + float(self.products[0, 0]))


@dataclass(frozen=True)
class Tangents:
    """All effects at their starts."""

    linearized: Linearized
    members: tuple[Member, ...]
    every: tuple[Tangent, ...]
    together: int  # Rows that are summed up

    @cached_property
    def energy(self) -> float:
        """Energy of the nominal model's gap, coefficients marginalized."""
        gap = self.linearized.measured - self.linearized.nominal
        return float(self.linearized.unexplained_products(gap[:, None])[0, 0])

    @property
    def nominal_misfit(self) -> float:
        """Misfit of the nominal model."""
        return 0.5 * self.linearized.problem.weight * self.energy

    def of(self, member: Member) -> list[Tangent]:
        """Tangents of an effect."""
        return [one for one in self.every if one.member is member]

    def without(self, members: Sequence[Member]) -> Tangents:
        """The same without some effects."""
        dropped = {id(member) for member in members}
        kept = tuple(one for one in self.members if id(one) not in dropped)
        return Tangents(self.linearized, kept, tuple(one for one in self.every if id(one.member) not in dropped), self.together)

    @cached_property
    def _columns(self) -> Array:
        return summed(self.linearized.columns, self.together)

    @cached_property
    def _factor(self) -> tuple[Array, bool] | None:
        weight, count = self.linearized.problem.weight, self.linearized.count
        return cho_factor(weight * self._columns.T @ self._columns + np.eye(count)) if count else None

    @cached_property
    def _along(self) -> list[Array]:
        """Of every tangent, products (K, 1 + Q) with the columns of the coefficients."""
        return [self._columns.T @ one.signals for one in self.every]

    def products(self, signals: Array, along: Array | None = None) -> Array:
        """Products of kept signals (m, C), given those with the columns of the coefficients."""
        found = signals.T @ signals
        if self._factor is not None:
            along = self._columns.T @ signals if along is None else along
            found -= self.linearized.problem.weight * (along.T @ cho_solve(self._factor, along))
        return np.asarray(found, dtype=np.float64)

    def toward(self, residual: Array) -> tuple[float, list[Array]]:
        """Energy of a residual (M,), and the products of every tangent with it."""
        weight, left = self.linearized.problem.weight, summed(residual, self.together)
        if self._factor is None:
            return float(left @ left), [one.signals.T @ left for one in self.every]
        along = self._columns.T @ left
        known = cho_solve(self._factor, along)
        energy = float(left @ left - weight * (along @ known))
        return energy, [one.signals.T @ left - weight * (own.T @ known) for one, own in zip(self.every, self._along, strict=True)]


def tangents_of(linearized: Linearized, members: Sequence[Member]) -> Tangents:
    """Simulate all effects at their starts; what cannot be simulated there is left out."""
    number = sum(len(member.starts()) * (1 + member.size) for member in members)
    together = max(-(-number * len(linearized.measured) // MAX_VALUES), 1)
    found = map_forked(lambda i: _simulated(linearized, members[i], together), len(members))  # arrays only: members stay here
    every = [Tangent(member, *one) for member, each in zip(members, found, strict=True) for one in each]
    return Tangents(linearized, tuple(members), tuple(every), together)


def _simulated(linearized: Linearized, member: Member, together: int) -> list[tuple[Array, tuple[int, ...], Array, Array, Array]]:
    """Signals of an effect at its starts, with their products."""
    unknowns, nominal, found = Candidate((member,)).unknowns(), np.zeros(linearized.count), []
    starts, gap = member.starts(), linearized.measured - linearized.nominal
    fitted = tuple(range(member.size))
    if len(member.parameters) == member.size and len(starts) > MANY:
        fitted = tuple(i for i, parameter in enumerate(member.parameters) if not parameter.logarithmic)
    for start in starts:
        try:
            there = linearized.nominal if member.is_absent(start) else linearized.simulate(nominal, unknowns, start)
            if not is_bounded(there):
                continue
            columns = effect_columns(linearized, unknowns, nominal, start, there, chosen=fitted)
        except InputError:
            continue
        signals = np.column_stack([there - linearized.nominal, columns])
        products = linearized.unexplained_products(np.column_stack([signals, gap]))
        found.append((start, fitted, summed(signals, together), products[:-1, :-1], products[:-1, -1]))
    return found


def summed(rows: Array, together: int) -> Array:
    """Rows (M, …) summed up by so many, each with a sign of chance that is the same for all signals."""
    if together == 1:
        return rows
    signs = np.random.default_rng(0).choice((-1.0, 1.0), len(rows)).reshape(-1, *(1,) * (rows.ndim - 1))
    padded = np.zeros((-(-len(rows) // together) * together, *rows.shape[1:]))
    padded[: len(rows)] = rows * signs
    found: Array = padded.reshape(-1, together, *rows.shape[1:]).sum(axis=1)
    return found
