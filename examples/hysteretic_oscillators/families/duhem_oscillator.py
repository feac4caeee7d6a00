# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The family "duhem_oscillator": an oscillator with a hysteretic force of any shape, whose branches are straight between knots.

Nothing is assumed of the branches. A fit with few knots is the start of one with more; their number is chosen by the error on rows
that are held out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.parallel import map_forked
from hyst_control.identify.assess.assembly import AxisFit
from hyst_control.identify.families.estimator import Estimator, register
from hyst_control.identify.families.options import INTEGER, TRUTH, Options, option
from hyst_control.identify.families.shared_options import nuisance_option
from hyst_control.identify.solve.simulation_error import Solution
from hyst_control.records.record import Record
from hysteretic_oscillators.families.oscillator_fit import Linear, Problem, axis_fit, problem_of
from hysteretic_oscillators.stages.duhem_oscillator import DuhemOscillator

SHARE = 0.5
"""Share of the force in the stiffness for small motions about which the parameters are stated."""
SHARES, WIDTHS = (0.3, 0.7), (0.1, 0.5, 2.0)
"""Starts of that share, and of the difference of the branches' slopes per travel."""
TRIAL_PASSES, PASSES, FINAL_PASSES = 6, 25, 12
NEGLIGIBLE_IMPROVEMENT = 0.02
"""A table is preferred to a larger one whose error on held-out rows is smaller by no more than this fraction."""


@dataclass(frozen=True)
class DuhemOptions(Options):
    """Options of a fit of a Duhem oscillator."""

    table_size: int | None = option(
        None, INTEGER, "number of knots of the branches, where it is not to be chosen on held-out data", lower=2, upper=40
    )
    largest_table: int = option(7, INTEGER, "largest number of knots that is tried", lower=2, upper=40)
    symmetric: bool = option(
        True,
        TRUTH,
        "make falling branches of rising ones by turning them about the origin; without this the force's zero is that of the rest "
        "from which the records begin",
    )
    nuisance: str = nuisance_option("offset")


@dataclass(frozen=True)
class Table:
    """The branches as parameters of order one: slopes at the knots in units of a stiffness."""

    knots: Annotated[Array, "K"]  # Forces (K,), V
    unit: float  # V/measurement unit
    # Whether the parameters are those of rising motion alone (K), with falling(z) = rising(-z), or of both (2 K)
    symmetric: bool

    @property
    def size(self) -> int:
        """Number of parameters."""
        return len(self.knots) * (2 - self.symmetric)

    @property
    def lhs(self) -> Array:
        """No constraints."""
        return np.zeros((0, self.size))

    @property
    def rhs(self) -> Array:
        """No constraints."""
        return np.zeros(0)

    def branches(self, vector: Array) -> Annotated[Array, "2 K"]:
        """Slopes of rising and falling motion at the knots."""
        slopes = self.unit * vector
        return np.stack([slopes, slopes[::-1]]) if self.symmetric else slopes.reshape(2, -1)

    def stage(self, linear: Linear, vector: Array) -> DuhemOscillator:
        """Construct the stage of one axis."""
        rising, falling = self.branches(vector)
        mass, damping = linear.mechanics
        return DuhemOscillator(mass, damping, (1.0 - SHARE) * linear.stiffness, self.knots, rising, falling)

    def refined(self, count: int, least: float, greatest: float, vector: Annotated[Array, "P"]) -> tuple[Table, Array]:
        """Change the knots."""
        reach = max(-least, greatest)
        knots = np.linspace(-reach, reach, count) if self.symmetric else np.linspace(least, greatest, count)
        branches = [np.interp(knots, self.knots, row) for row in vector[3:].reshape(2 - self.symmetric, -1)]
        return replace(self, knots=knots), np.concatenate([vector[:3], *branches])


@register
class DuhemFit(Estimator[DuhemOptions]):
    """Hysteresis inside the feedback of the mechanics, of any shape."""

    name = "duhem_oscillator"
    sentence = (
        "Duhem oscillator: mechanics whose restoring force has hysteresis with branches of any shape, straight between knots whose "
        "number is chosen on held-out rows"
    )
    Options = DuhemOptions

    def fit_axis(self, records: Sequence[Record], index: int, options: DuhemOptions) -> AxisFit:
        problem = problem_of(records, index, options.nuisance)
        selection = problem.selection
        law, best = linear_branches(selection, options.symmetric)
        counts = range(3, options.largest_table + 1) if options.table_size is None else (options.table_size,)
        for count in counts:
            finer, start = law.refined(count, *selection.force_range(law, best.parameters), best.parameters)
            found = selection.fit(finer, start, passes=PASSES, tolerance=1e-5)
            if options.table_size is not None or found.held_out < (1.0 - NEGLIGIBLE_IMPROVEMENT) ** 2 * best.held_out:
                law, best = finer, found
        final = problem.fit(law, best.parameters, passes=FINAL_PASSES, everything=True, tolerance=1e-6)
        return axis_fit(problem, law, final, best.held_out)


def linear_branches(problem: Problem, symmetric: bool) -> tuple[Table, Solution]:
    """Fit branches without a bend, from several starts."""
    scale = problem.linear.stiffness * problem.linear.travel
    law = Table(np.array([-SHARE, SHARE]) * scale, problem.linear.stiffness, symmetric)
    starts = []
    for share, width in product(SHARES, WIDTHS):
        spring = np.log((1.0 - share) / (1.0 - SHARE))  # mass and damping stay
        slopes = share - width * np.array([-SHARE, SHARE])
        starts.append(np.concatenate([spring * np.array([1.0, 0.5, -0.5]), slopes, slopes[::-1][: law.size - 2]]))

    def trial(index: int) -> Solution:
        return problem.fit(law, starts[index], passes=TRIAL_PASSES)

    best = min(map_forked(trial, len(starts)), key=lambda found: found.fitted)
    law, start = law.refined(2, *problem.force_range(law, best.parameters), best.parameters)
    return law, problem.fit(law, start, passes=PASSES, tolerance=1e-5)
