"""Zero of a session: what differs between records of one machine that nothing was done to.

The sensor's zero and the piezo's remanence differ from session to session, and creep goes on through each; a straight line and a
parabola over the record take that off, and leave what follows the command.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hyst_control.records.row_store import blocks, empty_rows

Array = NDArray[np.float64]

SHAPES = ("zero", "drift", "curvature")
"""Legendre polynomials of degree 0, 1 and 2 over a record."""

USUAL = 0.99
"""Probability with which the next session lies within what is called usual."""


def without_zero(rows: Array) -> tuple[Array, Array]:
    """Take zero, drift and curvature off an error.

    Parameters
    ----------
    rows : ndarray, shape (N, A)
        Measured minus simulated over one record, measurement unit.

    Returns
    -------
    rest : ndarray, shape (N, A)
        Measurement unit.
    coefficients : ndarray, shape (A, 3)
        Of the Legendre polynomials, measurement unit.
    """
    gram, product = np.zeros((len(SHAPES), len(SHAPES))), np.zeros((len(SHAPES), rows.shape[1]))
    for part in blocks(len(rows)):
        basis = _basis(part, len(rows))
        gram += basis.T @ basis
        product += basis.T @ rows[part]
    coefficients = np.linalg.lstsq(gram, product, rcond=None)[0]
    rest = empty_rows(*rows.shape)
    for part in blocks(len(rows)):
        rest[part] = rows[part] - _basis(part, len(rows)) @ coefficients
    return rest, np.asarray(coefficients.T, dtype=np.float64)


def _basis(part: slice, count: int) -> Array:
    """Legendre polynomials (n, 3) at some of `count` rows, which span -1 to 1."""
    place = -1.0 + 2.0 * np.arange(part.start, part.stop) / max(count - 1, 1)
    return np.asarray(np.polynomial.legendre.legvander(place, len(SHAPES) - 1), dtype=np.float64)


def usual_zero(coefficients: Array) -> Array:
    """Bound of what is usual: the prediction interval of the next session, from those of clean records.

    For n normal values with mean m and standard deviation s, the next one lies within m +- t s sqrt(1 + 1/n) with probability `USUAL`,
    t being the quantile of Student's distribution with n - 1 degrees of freedom. Two records say little (t = 64), five a good deal (5).

    Parameters
    ----------
    coefficients : ndarray, shape (R, A, 3)
        Zero, drift and curvature of clean records, measurement unit; see `without_zero`.

    Returns
    -------
    ndarray, shape (A, 3)
        Largest usual size, measurement unit; NaN for a single record, which does not say what is usual.
    """
    count = len(coefficients)
    if count < 2:
        return np.full(np.shape(coefficients)[1:], np.nan)
    from scipy.stats import t as student_t  # here, not above: it takes longer to import than all that a node needs

    reach = float(student_t.ppf(0.5 + 0.5 * USUAL, count - 1)) * np.sqrt(1.0 + 1.0 / count)
    mean, deviation = np.mean(coefficients, axis=0), np.std(coefficients, axis=0, ddof=1)
    return np.asarray(np.abs(mean) + reach * deviation, dtype=np.float64)
