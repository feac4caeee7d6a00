"""Zero of a session: what differs between records of one machine that nothing was done to.

The sensor's zero and the piezo's remanence differ from session to session, and creep goes on through each; a straight line and a
parabola over the record take that off, and leave what follows the command.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SHAPES = ("zero", "drift", "curvature")
"""Legendre polynomials of degree 0, 1 and 2 over a record."""


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
    basis = np.polynomial.legendre.legvander(np.linspace(-1.0, 1.0, len(rows)), len(SHAPES) - 1)
    coefficients = np.linalg.lstsq(basis, rows, rcond=None)[0]
    return np.asarray(rows - basis @ coefficients, dtype=np.float64), np.asarray(coefficients.T, dtype=np.float64)
