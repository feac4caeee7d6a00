# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Influence of a covariate such as temperature on a quantity of every unit, taken out before changes are looked for.

Successive runs of a unit are compared: levels, shifts and slow drifts leave their differences nearly untouched. The fleet's slope is
fitted to all differences with Huber's weights, its standard error allows for runs that all units share (clusters by run).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.fleet.course_fit import MAD, successive_differences

HUBER = 1.345
"""Residual, in standard deviations, from which a difference counts less: 95 % efficient for a normal law (Huber 1981)."""
ROUNDS = 20
MIN_DIFFERENCES = 20  # Differences that a slope is fitted to
DEVIATIONS = 4.0  # Standard errors from which a slope is believed


@dataclass(frozen=True)
class CovariateEffect:
    """Influence of a covariate on a quantity."""

    quantity: str
    covariate: str  # Column of the manifest
    slope: float  # Change of the quantity per unit of the covariate
    slope_error: float  # Its standard error


def take_out(
    quantity: str, values: Annotated[Array, "U T"], covariates: Mapping[str, Array]
) -> tuple[Array, list[CovariateEffect]]:
    """Take the influence of covariates out of a quantity, one after the other."""
    left, found = values, []
    for name, covariate in covariates.items():
        effect = _slope(quantity, name, left, covariate)
        if effect is not None and abs(effect.slope) > DEVIATIONS * effect.slope_error:
            found.append(effect)
            left = left - effect.slope * np.where(np.isfinite(covariate), covariate - np.nanmean(covariate), 0.0)
    return left, found


def _slope(quantity: str, name: str, values: Array, covariate: Array) -> CovariateEffect | None:
    (x, y), run = successive_differences(covariate, values)
    spread = MAD * np.median(np.abs(y - np.median(y))) if len(y) else 0.0
    if len(x) < MIN_DIFFERENCES or spread <= 0.0 or np.ptp(x) <= 0.0:
        return None
    slope = 0.0
    weights = np.ones(len(x))
    for _ in range(ROUNDS):
        slope = float((weights * x) @ y / ((weights * x) @ x))
        rest = y - slope * x
        spread = max(MAD * float(np.median(np.abs(rest))), 1e-300)
        weights = np.minimum(1.0, HUBER * spread / np.maximum(np.abs(rest), 1e-300))
    scores = np.bincount(run, weights * x * (y - slope * x))
    error = float(np.sqrt(scores @ scores) / ((weights * x) @ x))
    return CovariateEffect(quantity, name, slope, error)
