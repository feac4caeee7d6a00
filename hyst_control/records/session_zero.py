# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Zero of a session: what differs between records of one machine that nothing was done to.

The sensor's zero and the piezo's remanence differ from session to session, and creep goes on through each; a straight line and a
parabola over the record take that off, and leave what follows the command.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.records.stream.row_store import blocks, empty_rows

SHAPES = ("zero", "drift", "curvature")  # Legendre polynomials of degree 0, 1 and 2 over a record
USUAL = 0.99  # Probability with which the next session lies within what is called usual


def without_zero(rows: Annotated[Array, "N A"]) -> tuple[Array, Array]:
    """Take zero, drift and curvature off an error."""
    coefficients = zero_of(((part, rows[part]) for part in blocks(len(rows))), len(rows))
    rest = empty_rows(*rows.shape)
    for part in blocks(len(rows)):
        rest[part] = rows[part] - basis(part, len(rows)) @ coefficients
    return rest, np.asarray(coefficients.T, dtype=np.float64)


def zero_of(rows: Iterable[tuple[slice, Array]], count: int) -> Annotated[Array, "3 A"]:
    """Zero, drift and curvature of rows that come block by block."""
    gram: Array = np.zeros((len(SHAPES), len(SHAPES)))
    product: Array | float = 0.0
    for part, block in rows:
        shapes = basis(part, count)
        gram += shapes.T @ shapes
        product = product + shapes.T @ block
    return np.asarray(np.linalg.lstsq(gram, product, rcond=None)[0], dtype=np.float64)


def basis(part: slice, count: int) -> Array:
    """Legendre polynomials (n, 3) at `part` of `count` rows, which span -1 to 1."""
    place = -1.0 + 2.0 * np.arange(part.start, part.stop) / max(count - 1, 1)
    return np.asarray(np.polynomial.legendre.legvander(place, len(SHAPES) - 1), dtype=np.float64)


def usual_zero(coefficients: Annotated[Array, "R A 3"]) -> Annotated[Array, "A 3"]:
    """Bound of what is usual: the prediction interval of the next session, from those of baseline records."""
    # For n normal values with mean m and standard deviation s, the next one lies within m +- t s sqrt(1 + 1/n) with probability `USUAL`,
    # t being the quantile of Student's distribution with n - 1 degrees of freedom. Two records say little (t = 64), five a good deal (5).
    count = len(coefficients)
    if count < 2:
        return np.full(np.shape(coefficients)[1:], np.nan)
    from scipy.special import stdtrit  # here, not above: nodes do not need it

    reach = float(stdtrit(count - 1, 0.5 + 0.5 * USUAL)) * np.sqrt(1.0 + 1.0 / count)
    mean, deviation = np.mean(coefficients, axis=0), np.std(coefficients, axis=0, ddof=1)
    return np.asarray(np.abs(mean) + reach * deviation, dtype=np.float64)
