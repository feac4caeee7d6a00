"""Bounded linear least squares from Gram matrices."""

from __future__ import annotations

import numpy as np
from scipy.optimize import lsq_linear

from hyst_control.chain.stage import Array


def solve_bounded(gram: Array, target: Array, lower: Array, upper: Array) -> Array:
    """Minimize x' gram x - 2 target' x within bounds.

    Columns are scaled to unit length first; directions that the data do not show keep the smallest solution.

    Parameters
    ----------
    gram, target
        Normal equations (K, K) and (K,).
    lower, upper
        Bounds (K,), infinite where there are none.

    Returns
    -------
    Array
        The minimum x (K,).
    """
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    scaled = gram / scale[:, None] / scale
    values, vectors = np.linalg.eigh(scaled)
    values = np.maximum(values, 1e-13 * values[-1])
    root = np.sqrt(values)
    design = root[:, None] * vectors.T
    right = (vectors.T @ (target / scale)) / root
    low, high = lower * scale, upper * scale
    if not (np.any(np.isfinite(low)) or np.any(np.isfinite(high))):
        free: Array = np.linalg.lstsq(design, right, rcond=None)[0] / scale
        return free
    solution = lsq_linear(design, right, (low, high), method="bvls", tol=1e-12, max_iter=200)
    bounded: Array = np.clip(solution.x / scale, lower, upper)
    return bounded


def cost(gram: Array, solution: Array) -> float:
    """Return the sum of squared residuals of a solution.

    Parameters
    ----------
    gram
        Gram matrix (K + 1, K + 1) of [columns, y].
    solution
        Coefficients (K,) of the columns.

    Returns
    -------
    float
        Sum of squares, never negative.
    """
    vector = np.append(solution, -1.0)
    return max(float(vector @ gram @ vector), 0.0)


def covariance(blocks: Array, solution: Array) -> Array:
    """Estimate the covariance of a least-squares solution from blocks of rows.

    The sandwich estimate with blocks as clusters (Liang and Zeger, Biometrika 73, 1986): residuals may be correlated within a
    block, as those of a model error are, without underestimating the errors of the parameters.

    Parameters
    ----------
    blocks
        Gram matrices (B, K + 1, K + 1) of the blocks of [columns, y].
    solution
        Least-squares solution (K,).

    Returns
    -------
    Array
        Covariance (K, K).
    """
    gram = blocks.sum(axis=0)[:-1, :-1]
    scores = blocks[:, :-1, -1] - blocks[:, :-1, :-1] @ solution
    scale = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    values, vectors = np.linalg.eigh(gram / scale[:, None] / scale)
    inverse = (vectors / np.maximum(values, 1e-13 * values[-1])) @ vectors.T
    spread = (scores / scale).T @ (scores / scale) * len(blocks) / max(len(blocks) - 1, 1)
    found: Array = (inverse @ spread @ inverse) / scale[:, None] / scale
    return found
