# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Cases of a plant for which a loop must keep its margins: gains and resonances about a model's, and any model error beside them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from hyst_control.base.arrays import Array, Complex, Mask
from hyst_control.control.linearization import hysteresis_slopes, linearized, sampled_response
from hyst_control.control.loop_margins import Margins, margins, min_distance, worst
from hyst_control.control.moving_modes import well_damped, with_fixed_zeros, with_modes
from hyst_control.model_file import Model


@dataclass(frozen=True)
class Plants:
    """Cases of a plant, the model first."""

    z: Complex  # Points (F,) of the unit circle, in order of frequency
    responses: Complex  # (K, F, A, A)
    unknown: Mask  # (F,), points at which |L| is at most `UNKNOWN`

    @classmethod
    def nominal(cls, model: Model, sample_time: float, loop_delay: int, z: Complex) -> Plants:
        """The model itself."""
        return cls(z, spread_responses(model, sample_time, loop_delay, 0.0, 0.0, z)[:1], np.zeros(len(z), bool))

    def part(self, cases: int | None = None, every: int = 1) -> Plants:
        """The first cases, at every so many points."""
        return Plants(self.z[::every], self.responses[:cases, ::every], self.unknown[::every])

    @cached_property
    def mixed(self) -> bool:
        """True where an axis drives another."""
        return bool(np.any(self.responses * (1.0 - np.eye(self.responses.shape[-1]))))

    @cached_property
    def loci(self) -> Complex:
        """Characteristic loci (K · A, F); of axes that are not mixed their responses."""
        return np.concatenate([_loci(case) for case in self.responses])

    @cached_property
    def sizes(self) -> tuple[Array, Array]:
        """Greatest and least singular value (K, F) of the responses."""
        return singular_values(self.responses)

    @cached_property
    def inverses(self) -> Complex:
        """Inverses (K, F, A, A) of the responses."""
        return np.asarray(np.linalg.pinv(self.responses), dtype=np.complex128)

    def sensitivities(self, controller: Complex) -> tuple[Array, Array]:
        """|S| and |T| of the loops with a controller (F,): (M, F) of every axis or, of mixed ones, greatest singular values (K, F)."""
        if not self.mixed:
            loops = self.loci * controller
            return np.abs(1.0 / (1.0 + loops)), np.abs(loops / (1.0 + loops))
        return closed_loop(self.responses, self.inverses, controller)

    def distance(self, controller: Complex, error: float = 0.0, enough: float = np.inf) -> float:
        """The least 1 / |S| of the loops with a controller (F,), over all relative errors up to `error`; `enough` at most."""
        if not self.mixed:
            return min_distance(self.loci * controller, error)
        # Bounds tell that a loop of little or much gain is far from -1.
        greatest, least = (size * np.abs(controller) for size in self.sizes)
        near = ((1.0 + error) * greatest > 1.0 - enough) & ((1.0 - error) * (least - 1.0) - error < enough)
        at = np.nonzero(near)
        sensitivity, complementary = closed_loop(self.responses[at], self.inverses[at], controller[at[1]])
        return float(((1.0 - error * complementary) / sensitivity).min(initial=enough))

    def margins(self, controller: Complex, sample_time: float, error: float = 0.0) -> Margins:
        """Worst margins of the loops with a controller (F,)."""
        loops = self.loci * controller
        return replace(
            worst([margins(loop, self.z, sample_time, error) for loop in loops]),
            peak_sensitivity=1.0 / self.distance(controller, error),
        )


def singular_values(matrices: Complex) -> tuple[Array, Array]:
    """Greatest and least singular value (...) of matrices (..., A, A)."""
    if matrices.shape[-1] != 2:
        found = np.asarray(np.linalg.svd(matrices, compute_uv=False), dtype=np.float64)
        return found[..., 0], found[..., -1]
    (a, b), (c, d) = np.moveaxis(matrices, (-2, -1), (0, 1))  # a closed form is ten times as fast
    size = (np.abs(matrices) ** 2).sum(axis=(-2, -1))
    product: Array = np.abs(a * d - b * c)
    greatest: Array = np.sqrt(0.5 * (size + np.sqrt(np.maximum(size**2 - 4.0 * product**2, 0.0))))
    return greatest, product / np.maximum(greatest, 1e-300)


def closed_loop(responses: Complex, inverses: Complex, controller: Complex) -> tuple[Array, Array]:
    """Greatest singular values (...) of S = 1 / (1 + L) and T = 1 / (1 + 1 / L), from responses, their inverses and a controller."""
    one, gain = np.eye(responses.shape[-1]), controller[..., None, None]
    return 1.0 / singular_values(one + gain * responses)[1], 1.0 / singular_values(one + inverses / gain)[1]


def spread_responses(
    model: Model,
    sample_time: float,
    loop_delay: int,
    gain_spread: float,
    mode_spread: float,
    z: Complex,
    alone: Sequence[complex] = (),
    quiet: Sequence[complex] = (),
) -> Complex:
    """Responses (K, F, A, A) at points of the z plane, the nominal model first, measurement unit per V.

    The other cases are at the ends of the relative spreads of the gain, and of the frequency of all resonances together and of those
    of the poles `alone` (rad/s), each by itself. Resonances of the poles `quiet`, of none of these, are well damped.
    """
    axes = len(model.axes)
    _, greatest = hysteresis_slopes(model)
    stages = linearized(model, greatest)
    ends = (1.0 - mode_spread, 1.0 + mode_spread)
    together = [(end, with_modes(stages, axes, end)) for end in ends]
    damped: Complex = np.array(quiet, dtype=np.complex128)
    plants = [well_damped(plant, axes, np.asarray(end * damped)) for end, plant in [(1.0, stages), *together]]
    plants += [with_modes(stages, axes, end, np.array([pole])) for pole in alone for end in ends]
    if mode_spread and not len(damped):
        plants += [with_fixed_zeros(stages, axes, end) for end in ends]
    responses = []
    for plant in plants:
        response = sampled_response(plant, axes, sample_time, z) * (z**-loop_delay)[:, None, None]
        responses += [gain * response for gain in (1.0, 1.0 - gain_spread, 1.0 + gain_spread)]
    return np.array(responses)


def _loci(responses: Complex) -> Complex:
    """Eigenvalues (A, F) of responses (F, A, A), each continued from point to point; the diagonal where no axis drives another."""
    axes = responses.shape[1]
    diagonal = responses[:, np.arange(axes), np.arange(axes)]
    if not np.any(responses * (1.0 - np.eye(axes))):
        return diagonal.T
    from scipy.optimize import linear_sum_assignment  # only here: nodes of the loop load this module

    found = np.linalg.eigvals(responses)
    for before, here in pairwise(found):
        here[:] = here[linear_sum_assignment(np.abs(before[:, None] - here))[1]]
    return np.asarray(found.T, dtype=np.complex128)
