# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The family "bouc_wen": a Bouc-Wen oscillator from records of any excitation that moves it through its loops."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.parallel import map_forked
from hyst_control.identify.assess.assembly import AxisFit
from hyst_control.identify.families.estimator import Estimator, register
from hyst_control.identify.families.options import NUMBER, Options, option
from hyst_control.identify.families.shared_options import nuisance_option
from hyst_control.records.record import Record
from hysteretic_oscillators.families.oscillator_fit import Linear, axis_fit, problem_of
from hysteretic_oscillators.stages.bouc_wen import BoucWen

SHARES, WIDTHS = (0.3, 0.7), (0.5, 2.0, 8.0)
"""Starts of the force's share of the stiffness for small motions, and of beta in units of one over the travel."""
MIN_SHARE = 1e-3
"""Least share of the force, and of the spring, in the stiffness for small motions."""
TRIAL_PASSES, PASSES, FINAL_PASSES = 6, 40, 12


@dataclass(frozen=True)
class BoucWenOptions(Options):
    """Options of a fit of a Bouc-Wen oscillator."""

    exponent: float | None = option(
        None, NUMBER, "exponent of the hysteretic force, where it is not to be estimated", lower=1.0, upper=50.0
    )
    nuisance: str = nuisance_option("offset")


@dataclass(frozen=True)
class Formula:
    """Bouc-Wen's law as parameters of order one.

    They are alpha's share of the stiffness for small motions, beta and gamma in units of one over travel and force, and exponent - 1.
    """

    exponent: float | None  # The exponent; None: a parameter

    @property
    def size(self) -> int:
        """Number of parameters."""
        return 3 if self.exponent is not None else 4

    @property
    def lhs(self) -> Array:
        """Left sides of: the share is from `MIN_SHARE` to 1 - `MIN_SHARE`, beta at least 0, the exponent at least 1."""
        unit = np.eye(self.size)
        return np.array([unit[0], -unit[0], unit[1], *unit[3:]])

    @property
    def rhs(self) -> Array:
        """Right sides."""
        return np.array([MIN_SHARE, MIN_SHARE - 1.0, *np.zeros(self.size - 2)])

    def stage(self, linear: Linear, vector: Array) -> BoucWen:
        """Construct the stage of one axis."""
        mass, damping = linear.mechanics
        alpha = float(vector[0]) * linear.stiffness
        exponent = self.exponent if self.exponent is not None else 1.0 + max(float(vector[3]), 0.0)
        unit = (0.5 * alpha * linear.travel) ** (1.0 - exponent) / linear.travel
        spring = linear.stiffness - alpha
        return BoucWen(mass, damping, spring, alpha, float(vector[1]) * unit, float(vector[2]) * unit, exponent)


@register
class BoucWenOscillator(Estimator[BoucWenOptions]):
    """Hysteresis inside the feedback of the mechanics, by a formula of four parameters."""

    name = "bouc_wen"
    sentence = (
        "Bouc-Wen oscillator: mechanics whose restoring force has hysteresis, all parameters together on the simulation error, from "
        "several starts"
    )
    Options = BoucWenOptions

    def fit_axis(self, records: Sequence[Record], index: int, options: BoucWenOptions) -> AxisFit:
        problem, law = problem_of(records, index, options.nuisance), Formula(options.exponent)
        selection = problem.selection
        starts = [np.array([0.0, 0.0, 0.0, share, width, *np.zeros(law.size - 2)]) for share, width in product(SHARES, WIDTHS)]
        trials = map_forked(lambda i: selection.fit(law, starts[i], passes=TRIAL_PASSES), len(starts))
        best = min(trials, key=lambda found: found.fitted)
        chosen = selection.fit(law, best.parameters, passes=PASSES, tolerance=1e-6)
        final = problem.fit(law, chosen.parameters, passes=FINAL_PASSES, everything=True, tolerance=1e-6)
        return axis_fit(problem, law, final, chosen.held_out, () if options.exponent is None else ("exponent",))
