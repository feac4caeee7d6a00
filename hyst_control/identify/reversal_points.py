"""Turning points of a command: all that rate-independent hysteresis remembers."""

from __future__ import annotations

import numpy as np

from hyst_control.chain.stage import Array


def turning_points(command: Array) -> Array:
    """Indices of the samples at which a signal (N,) turns; play operators remember nothing else."""
    slope = np.sign(np.diff(command))
    moving = np.flatnonzero(slope)
    turns = moving[1:][slope[moving[1:]] != slope[moving[:-1]]]
    return np.concatenate([[0], turns]).astype(int)
