# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A fitted structure of the family "linear", what it leaves, and whether it is better than another one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.identify.modal.partial_fractions import Sections
from hyst_control.identify.solve.simulation_error import Solution

MIN_GAIN = 0.02  # Share of the held-out mean square error by which a larger model has to be better, at least
WHITE, SURE = 2.0, 4.0
"""Ratio of the scatter of block energies to that of white noise up to which a residual is noise; standard errors of a significant gain."""


class Variant(NamedTuple):
    """Parts of a structure beside its states."""

    direct: bool
    delay: bool
    smooth: bool


VARIANTS = (
    Variant(direct=False, delay=False, smooth=True),
    Variant(direct=False, delay=True, smooth=True),
    Variant(direct=False, delay=False, smooth=False),
    Variant(direct=False, delay=True, smooth=False),
    Variant(direct=True, delay=False, smooth=False),
)
"""In the order of preference where they have equally many parameters: a delay rather than a zero in the right half plane."""


@dataclass(frozen=True, eq=False)
class Candidate:
    """A fitted structure."""

    variant: Variant
    sections: Sections
    solution: Solution
    seconds: float
    exact: float  # Mean square error from which a fit counts as exact
    equations: float  # Independent equations that the records hold, where these are fewer than their rows
    search_error: float | None = None  # Mean square error on the blocks held out, before the fit to all rows

    @property
    def held_out(self) -> float:
        """Mean square error on the blocks held out."""
        return max(self.solution.held_out, self.exact)

    @property
    def errors(self) -> tuple[float, float]:
        """Mean square errors on the blocks held out and, by Schwarz's criterion, on those fitted; the latter twice for a few sines."""
        rows = min(self.solution.grams.rows[0], self.equations)
        expected = max(self.solution.fitted, self.exact) * float(np.exp(self.sections.parameters * np.log(rows) / rows))
        return self.held_out if np.isinf(self.equations) else expected, expected

    @property
    def energies(self) -> Array:
        """Square errors of the blocks held out."""
        return self.solution.energies

    @property
    def scatter(self) -> float:
        """Relative standard deviation of the blocks' energies, which colored errors widen."""
        mean = float(np.mean(self.energies)) if len(self.energies) > 1 else 0.0
        return float(np.std(self.energies)) / mean if mean > 0.0 else 0.0

    @property
    def leaves_noise(self) -> bool:
        """True where the energies of the blocks scatter no more than those of white noise: then any significant gain counts."""
        rows = self.solution.grams.rows[1] / max(len(self.energies), 1)
        return bool(0.0 < self.scatter < WHITE * np.sqrt(2.0 / rows))

    @property
    def doubt(self) -> float:
        """Share of the held-out error that is within its standard error over the blocks."""
        return max(MIN_GAIN, self.scatter / float(np.sqrt(max(len(self.energies), 1))))

    def surely_beats(self, other: Candidate) -> bool:
        """True where the residual is noise, and significantly smaller on the blocks held out."""
        less = other.energies - self.energies
        return self.leaves_noise and float(np.sum(less)) > SURE * float(np.std(less)) * float(np.sqrt(len(less)))
