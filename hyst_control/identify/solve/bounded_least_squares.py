# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Bounded linear least squares from Gram matrices."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from scipy.special import ndtri, stdtrit

from hyst_control.base.arrays import Array

MIN_REST = 1e-4  # Share of what a block tells of a parameter that the others tell at least: no score grows beyond it
UNSEEN = 1e-20  # Share of the largest sum of squares up to which a parameter moves nothing: its variance is then the reciprocal


def solve_bounded(
    gram: Annotated[Array, "K K"], target: Annotated[Array, "K K"], lower: Annotated[Array, "K"], upper: Annotated[Array, "K"]
) -> Annotated[Array, "K"]:
    """Minimize x' gram x - 2 target' x within bounds.

    Columns are scaled to unit length first; directions that the data do not show keep the smallest solution.
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
    from scipy.optimize import lsq_linear  # nodes and a diagnosis have no use for it, and it takes long to import

    solution = lsq_linear(design, right, (low, high), method="bvls", tol=1e-12, max_iter=200)
    bounded: Array = np.clip(solution.x / scale, lower, upper)
    return bounded


def cost(gram: Array, solution: Annotated[Array, "K"]) -> float:
    """Return the sum of squared residuals of a solution."""
    vector = np.append(solution, -1.0)
    return max(float(vector @ gram @ vector), 0.0)


def covariance(blocks: Annotated[Array, "B K + 1 K + 1"], solution: Annotated[Array, "K"]) -> Annotated[Array, "K K"]:
    """Estimate the covariance of a least-squares solution from blocks of rows.

    The sandwich estimate with blocks as clusters (Liang and Zeger, Biometrika 73, 1986): residuals may be correlated within a
    block, as those of a model error are, without underestimating the errors of the parameters. Two corrections make it hold for short
    records: the residual of a block that decides about a parameter is small because the fit followed it, so every score is that of the
    solution without its block (the jackknife), and where few blocks decide, deviations are widened by Student's distribution, so that
    normal 90 % intervals hold (Bell and McCaffrey, Survey Methodology 28, 2002); and residuals that go on over the edge of a block
    correlate its score with its neighbors' (Newey and West, Econometrica 55, 1987).
    """
    gram = blocks.sum(axis=0)[:-1, :-1]
    known = np.diag(gram)
    scale = np.sqrt(np.maximum(known, max(UNSEEN * float(known.max()), 1e-300)))
    inner = blocks[:, :-1, :-1] / scale[:, None] / scale
    scores = (blocks[:, :-1, -1] - blocks[:, :-1, :-1] @ solution) / scale
    values, vectors = np.linalg.eigh(inner.sum(axis=0))
    values = np.maximum(values, 1e-13 * values[-1])
    # In coordinates in which the Gram matrix is the identity, that of the rest is 1 - own.
    white = vectors / np.sqrt(values)
    own = white.T @ inner @ white
    moved = np.linalg.solve(np.eye(len(gram)) * (1.0 + MIN_REST) - own, (scores @ white)[..., None])[..., 0]
    spread = moved.T @ moved
    for lag, weight in enumerate(_neighbor_weights(moved), 1):
        product = moved[lag:].T @ moved[:-lag]
        spread += weight * (product + product.T)
    # Share of every block in what is known of every parameter: their effective number is that of the degrees of freedom.
    part = np.einsum("ki,bij,kj->bk", white, own, white)
    freedom = part.sum(axis=0) ** 2 / np.maximum(np.sum(part**2, axis=0), 1e-300)
    scale = scale * ndtri(0.95) / stdtrit(np.maximum(freedom - 1.0, 1.0), 0.95)
    found: Array = (white @ spread @ white.T) / scale[:, None] / scale
    found[np.diag_indices(len(found))] = np.where(known > UNSEEN * known.max(), np.diag(found), 1.0 / UNSEEN)
    return found


def _neighbor_weights(scores: Array) -> Array:
    """Bartlett weights of the scores' (B, K) autocovariances; as many as their correlation asks for (Andrews, Econometrica 59, 1991)."""
    power = np.sum(scores**2, axis=0)
    used = power > 0.0
    correlation = np.sum(scores[1:, used] * scores[:-1, used], axis=0) / power[used]
    correlation = np.clip(correlation, -0.9, 0.9)
    alpha = np.sum(4.0 * correlation**2 / (1.0 - correlation) ** 6 / (1.0 + correlation) ** 2) / max(
        np.sum(1.0 / (1.0 - correlation) ** 4), 1e-300
    )
    width = min(1.1447 * (alpha * len(scores)) ** (1.0 / 3.0), len(scores) / 4.0)
    lags = np.arange(1.0, np.floor(width) + 1.0)
    weights: Array = 1.0 - lags / (np.floor(width) + 1.0)
    return weights
