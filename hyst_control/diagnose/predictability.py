"""Predictable share of a residual: the part of its energy that the command determines.

A residual has two parts. One varies from run to run although the command is the same; no model can explain it. The other follows the
command; the model lacks an effect. To separate them, the residual is regressed on features of the command's past. The regression is
fitted on some blocks of the record and judged on the others.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit

from hyst_control.chain.parameter import Array

PLAYS = (0.05, 0.15, 0.3, 0.5)
"""Half widths of the play operators, as shares of the command's range; together they approximate the memory of any hysteresis."""
LAGS = (1, 4, 16)
"""Lags of the command's copies, as multiples of a sixteenth of the time in which its fastest part crosses a quarter of its range."""
RIDGE = 1e-6
"""Ridge of the regression, as a share of the features' energy."""


def predictable_share(commands: Sequence[Array], residuals: Sequence[Array], blocks: int) -> float:
    """Compute the share of a residual's energy that features of the command predict on blocks not used for the fit.

    Parameters
    ----------
    commands : sequence of ndarray, shape (N, A)
        Commands of all records, V.
    residuals : sequence of ndarray, shape (N, A)
        Residuals of the same records, any unit.
    blocks : int
        Number of blocks that the records are divided into; each is predicted from all others.

    Returns
    -------
    float
        0 to 1; 0 if the features predict the residual no better than its mean does.
    """
    design = np.concatenate([features(command) for command in commands])
    target = np.concatenate(residuals)
    fold = np.arange(len(target)) * blocks // max(len(target), 1)
    left = np.zeros(target.shape)
    grams = [design[fold == block].T @ design[fold == block] for block in range(blocks)]
    rights = [design[fold == block].T @ target[fold == block] for block in range(blocks)]
    gram, right = sum(grams, np.zeros_like(grams[0])), sum(rights, np.zeros_like(rights[0]))
    ridge = RIDGE * np.trace(gram) / len(gram) * np.eye(len(gram))
    for block in range(blocks):
        weights = np.linalg.solve(gram - grams[block] + ridge, right - rights[block])
        left[fold == block] = target[fold == block] - design[fold == block] @ weights
    total = float(np.sum((target - target.mean(axis=0)) ** 2))
    return float(np.clip(1.0 - np.sum(left**2) / total, 0.0, 1.0)) if total > 0 else 0.0


def features(command: Array) -> Array:
    """Compute features of a command: a constant, its powers, its rate, products of these, play operators and lagged copies.

    Parameters
    ----------
    command : ndarray, shape (N, A)
        Command, V.

    Returns
    -------
    ndarray, shape (N, F)
        Features, each scaled to be independent of the command's unit.
    """
    found = [np.ones(len(command))]
    for axis in range(command.shape[1]):
        span = max(float(np.ptp(command[:, axis])), 1e-300)
        u = (command[:, axis] - command[:, axis].mean()) / span
        v = np.gradient(u)
        v /= max(float(np.max(np.abs(v))), 1e-300)
        found += [u, u**2, u**3, v, np.abs(v), u * v, u * np.abs(v), u**2 * v]
        found += [_play(u, half) for half in PLAYS]
        step = max(int(0.25 / max(float(np.max(np.abs(np.gradient(u)))), 1e-9) / 16), 1)
        found += [np.concatenate([np.full(min(lag * step, len(u)), u[0]), u])[: len(u)] for lag in LAGS]
    return np.stack(found, axis=1)


@njit(cache=True, error_model="numpy")
def _play(values: Array, half: float) -> Array:
    state, output = values[0], np.empty_like(values)
    for k in range(values.size):
        state = min(max(state, values[k] - half), values[k] + half)
        output[k] = state
    return output
