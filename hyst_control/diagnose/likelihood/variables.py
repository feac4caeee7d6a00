# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Variables of a record by which an unknown effect may act."""

from __future__ import annotations

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.diagnose.search.fit import Linearized

VARIABLES = ("time", "level", "rate", "branch")


def variables_of(linearized: Linearized) -> dict[str, Array]:
    """Variables (M,) by name, each within -1 … 1 on every axis."""
    pieces = linearized.problem.pieces
    low = np.min([piece.command.min(axis=0) for piece in pieces], axis=0)
    high = np.max([piece.command.max(axis=0) for piece in pieces], axis=0)
    rates = [np.gradient(piece.command, axis=0) for piece in pieces]
    usual = np.maximum(np.quantile(np.abs(np.concatenate(rates)), 0.9, axis=0), 1e-300)
    found: dict[str, list[Array]] = {name: [] for name in VARIABLES}
    for piece, rate in zip(pieces, rates, strict=True):
        time = np.linspace(-1.0, 1.0, len(piece.command))[:, None] + 0.0 * rate
        rows = {
            "time": time,
            "level": 2.0 * (piece.command - low) / np.maximum(high - low, 1e-300) - 1.0,
            "rate": 2.0 * np.minimum(np.abs(rate) / usual, 1.0) - 1.0,
            "branch": np.clip(10.0 * rate / usual, -1.0, 1.0),
        }
        for name, values in rows.items():
            found[name].append(piece.counted(values).reshape(-1))
    return {name: np.concatenate(parts) for name, parts in found.items()}
