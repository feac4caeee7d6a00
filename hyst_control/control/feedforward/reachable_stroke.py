# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Stroke that the drive can reach, memory of the hysteresis included, and the check of a reference against it."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.chain import Chain, Parallel, Sampling
from hyst_control.chain.hysteresis.madelung import Madelung
from hyst_control.chain.hysteresis.rate_dependent_prandtl_ishlinskii import RateDependentPrandtlIshlinskii
from hyst_control.chain.stage import SLOW
from hyst_control.control.feedforward.compensator import core_inverse, drive_limits, dynamics_inverse, quasi_static, split
from hyst_control.control.feedforward.mhl_inverse import constant_removed, inverted, rate_dependent_parts
from hyst_control.model_file import Model

TOLERANCE = 1e-3  # Share of the stroke by which a reference may miss the reachable interval: below the models' own accuracy


def check_reachable(model: Model, reference: Array, limits: tuple[ArrayLike, ArrayLike] | None = None) -> None:
    """Raise `InputError` when the drive cannot bring the model, slowly, along a reference (N, A) in the measurement unit.

    limits: (lower, upper) V, the model's valid command range by default. The reference is followed in order from rest at 0 V, so
    that what stays behind at the lower limit after a peak (HAMPI paper §5.3: about 0.7 um at 0 V after 55 V) counts.
    """
    reference = np.asarray(reference, dtype=float)
    axes = len(model.axes)
    if reference.ndim != 2 or reference.shape[1] != axes or not np.all(np.isfinite(reference)):
        raise InputError(
            f"reference: must be finite numbers with a column for each of the axes {', '.join(model.axes)}, got shape {reference.shape}"
        )
    command, bounds = quasi_static_command(model, reference, limits)
    reached = quasi_static(model, np.concatenate([np.zeros((1, axes)), command]))[1:]
    for axis, name in enumerate(model.axes):
        ends = quasi_static(model, bounds)[:, axis]
        missed = np.abs(reached[:, axis] - reference[:, axis]) > TOLERANCE * abs(ends[1] - ends[0])
        if not np.any(missed):
            continue
        peak = bounds[0].copy()
        peak[axis] = command[:, axis].max()
        low = quasi_static(model, np.stack([np.zeros(axes), peak, bounds[0]]))[-1, axis]
        unit = model.units["measurement"]
        asked = reference[missed, axis]
        raise InputError(
            f"reference of axis {name}: {missed.sum()} of {len(reference)} samples, {asked.min():.4g} to "
            f"{asked.max():.4g} {unit}, cannot be reached with {bounds[0, axis]:g} to {bounds[1, axis]:g} V: "
            f"after its peak this model moves between {low:.4g} and {ends[1]:.4g} {unit}; change offset or amplitude"
        )


def quasi_static_command(
    model: Model, reference: Annotated[Array, "N A"], limits: tuple[ArrayLike, ArrayLike] | None
) -> tuple[Array, Array]:
    """Commands (N, A) in V that follow a reference infinitely slowly, and the drive's bounds (2, A)."""
    axes = len(model.axes)
    bounds = drive_limits(model, limits)
    before, core, after = split(model)
    sampling = Sampling(SLOW, axes, "foh")
    stages, _ = dynamics_inverse(after, sampling, "none", "zoh")
    if isinstance(core, (Madelung, Parallel)):
        hysteresis, correction = rate_dependent_parts(core)
        stages = [*stages, *constant_removed(correction, axes), inverted(hysteresis)]
    else:
        # At rest a rate-dependent model is its classical part, k u + b of the modified one stay.
        kind = "hapi" if isinstance(core, RateDependentPrandtlIshlinskii) else "hampi"
        stages = [*stages, *core_inverse(model, bounds, kind, sampling, 0)]
    front, _ = dynamics_inverse(before, sampling, "none", "zoh")
    stages += front
    if not stages:
        return np.clip(reference, *bounds), bounds
    running = Chain(tuple(stages)).filter(sampling)
    running.settle(np.zeros(axes))
    return np.clip(running.process(np.ascontiguousarray(reference)), *bounds), bounds
