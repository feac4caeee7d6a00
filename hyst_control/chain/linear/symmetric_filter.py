# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Low-passes without phase: symmetric weights, which look as many samples ahead as their order."""

from __future__ import annotations

from functools import reduce

import numpy as np
from scipy.linalg import block_diag

from hyst_control.base.arrays import Array
from hyst_control.chain.linear.linear_stages import StateSpace


def flat_weights(order: int) -> Array:
    """Weights (2 order + 1,) of 1 - ((1 - cos w) / 2)^order at w radians per sample: flat up to near half the sampling rate."""
    weights = -reduce(np.convolve, [[-0.25, 0.5, -0.25]] * order, np.ones(1))
    weights[order] += 1.0
    return weights


def smooth_weights(order: int) -> Array:
    """Weights (2 order + 1,) of ((1 + cos w) / 2)^order at w radians per sample, binomial ones: falls early, and never overshoots."""
    return reduce(np.convolve, [[0.25, 0.5, 0.25]] * order, np.ones(1))


def weighted_sum(weights: Array, axes: int, sample_time: float) -> StateSpace:
    """Discrete stage that adds up the newest samples of each axis."""
    count = len(weights) - 1
    a, b = np.eye(count, k=-1), np.eye(count, 1)
    parts = (a, b, np.asarray(weights)[None, 1:], np.asarray(weights)[None, :1])
    a, b, c, d = (block_diag(*[part] * axes).tolist() for part in parts)
    return StateSpace(a, b, c, d, sample_time=float(sample_time))
