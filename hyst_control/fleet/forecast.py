# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Forecast of the time at which a drifting quantity reaches its limit, with the interval that slope and random walk leave open."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.stats import norm

from hyst_control.fleet.change_points import Trend

PROBABILITY = 0.9
"""Of the interval of the time of crossing."""


def forecast(trend: Trend, limits: Mapping[str, float]) -> Trend:
    """Add the time at which a trend reaches the limit of its quantity.

    At a time d after the last run the quantity is normal about ``level + slope d`` with the variance of the slope, (slope_error d)^2,
    and of the walk, walk^2 d. The interval holds the times between which the probability of being beyond the limit grows from 5 to
    95 %; an end is None where it never does.
    """
    limit = limits.get(trend.quantity)
    if limit is None:
        return trend
    ahead = (limit - trend.level) * np.sign(trend.slope)
    if ahead <= 0.0:
        return trend
    quantile = float(norm.ppf(0.5 + 0.5 * PROBABILITY))
    speed = abs(trend.slope)
    return replace(
        trend,
        crossing=trend.last + ahead / speed,
        earliest=_reached(trend, ahead, quantile),
        latest=_reached(trend, ahead, -quantile),
    )


def _reached(trend: Trend, ahead: float, deviations: float) -> float | None:
    """First time at which ``speed d + deviations sqrt((slope_error d)^2 + walk^2 d)`` is `ahead`; None where there is none.

    Squared, it is a quadratic equation; the sign of `deviations` chooses the root.
    """
    speed = abs(trend.slope)
    a = speed**2 - (deviations * trend.slope_error) ** 2
    b = -(2.0 * ahead * speed + (deviations * trend.walk) ** 2)
    roots = np.roots([a, b, ahead**2]) if abs(a) > 1e-12 * speed**2 else np.array([ahead**2 / -b])
    real = [float(root.real) for root in roots if abs(root.imag) < 1e-6 * abs(root) and root.real > 0.0]
    reached = [d for d in real if (ahead - speed * d) * deviations >= -1e-6 * ahead * abs(deviations)]
    return trend.last + min(reached) if reached else None
