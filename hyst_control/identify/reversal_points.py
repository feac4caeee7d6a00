"""Turning points of a command: all that rate-independent hysteresis remembers."""

from __future__ import annotations

import numpy as np

from hyst_control.chain.stage import Array


def turning_points(command: Array) -> Array:
    """Find the samples at which a signal turns; play operators remember no others.

    Parameters
    ----------
    command
        Signal (N,).

    Returns
    -------
    Array
        Indices of the samples, 0 first.
    """
    slope = np.sign(np.diff(command))
    moving = np.flatnonzero(slope)
    turns = moving[1:][slope[moving[1:]] != slope[moving[:-1]]]
    return np.concatenate([[0], turns]).astype(int)
