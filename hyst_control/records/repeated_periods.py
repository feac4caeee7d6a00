# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Period of a command that repeats, and what a record differs by from period to period."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array

SAME = 1e-3  # Rms difference of two commands, in the range of the first, up to which they are the same


def period_of(command: Annotated[Array, "N A"], same: float = SAME) -> int | None:
    """Find the period of a command."""
    from hyst_control.base.signals import correlated  # imports numba

    rows, count = command - command.mean(axis=0), len(command)
    products = np.sum([correlated(column, column) for column in rows.T], axis=0)[count - 1 :]
    squares = np.concatenate([[0.0], np.cumsum(np.sum(rows**2, axis=1))])
    lags = np.arange(count // 2 + 1)
    energy = squares[count - lags] + squares[-1] - squares[lags]
    difference = (energy - 2.0 * products[lags]) / (count - lags)
    apart = difference > squares[-1] / count  # half of what is unrelated
    if not apart.any():
        return None
    least = int(np.argmax(apart))
    equal = difference <= command.shape[1] * (same * np.ptp(command)) ** 2
    equal[:least] = False
    if not equal.any():
        return None
    first = int(np.argmax(equal))
    end = first + int(np.argmin(np.append(equal[first:], False)))
    return first + int(np.argmin(difference[first:end]))


def is_same(one: Annotated[Array, "N A"], other: Annotated[Array, "N A"], same: float = SAME) -> bool:
    """Compare two commands."""
    span = max(float(np.ptp(one)), 1e-300)
    return bool(np.sqrt(np.mean((one - other) ** 2)) <= same * span)
