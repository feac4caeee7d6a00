# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Judgment of a fit by what its simulation from the command explains, beside what a constant and a gain would."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypedDict

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.records.record import Record
from hyst_control.records.stream.row_store import blocks

LEAST = 0.1  # Share of a measurement's power, about one zero a record, that a model explains if it explains anything
AS_GOOD = 0.999  # Share from which a model is not held against a gain: both are then within the noise of small records
WORSE = 1.25  # Ratio of the unexplained powers of a model and a gain from which the model explains less

EXPLAINS, POORLY, DISAGREE = "explains", "explains_poorly", "records_disagree"
NOTHING, INVALID = "explains_nothing", "invalid_record"
"""Verdicts on a fit: of use; of use, but much is left; of records that differ under it; of no use, so not written; forced."""


class ExplainedRow(TypedDict):
    """Shares of an axis' measured power, about one zero a record, that the model's simulation explains, and a constant and a gain."""

    axis: str
    model: float
    gain: float


def explained_shares(records: Sequence[Record], errors: Sequence[Array]) -> list[ExplainedRow]:
    """Shares that a model explains of each axis that moves."""
    sums = np.zeros((4, len(records[0].axes)))  # of command², command · measurement, measurement², error²
    for data, error in zip(records, errors, strict=True):
        first = len(data.command) - len(error)
        command, measured = data.command[first:], data.measurement[first:]
        means = [np.mean(values, axis=0) for values in (command, measured, error)]
        for part in blocks(len(error)):
            u, y, e = (values[part] - mean for values, mean in zip((command, measured, error), means, strict=True))
            sums += [np.sum(u * u, axis=0), np.sum(u * y, axis=0), np.sum(y * y, axis=0), np.sum(e * e, axis=0)]
    rows: list[ExplainedRow] = []
    for axis, (uu, uy, yy, ee) in zip(records[0].axes, sums.T, strict=True):
        if uu > 0 and yy > 0:
            rows.append({"axis": axis, "model": float(1.0 - ee / yy), "gain": float(uy**2 / (uu * yy))})
    return rows


def useless(rows: Sequence[ExplainedRow]) -> list[ExplainedRow]:
    """Those of `rows` of which the model explains next to nothing, or less than a constant and a gain."""
    return [
        row
        for row in rows
        if not row["model"] >= LEAST or (row["model"] < AS_GOOD and 1.0 - row["model"] > WORSE * (1.0 - row["gain"]))
    ]


def sentence(row: ExplainedRow) -> str:
    """Note on a useless fit of the axis of `row`, as one line."""
    return (
        f"{row['axis']}: the model explains {100 * row['model']:.1f} % of the measured power, a constant and a gain "
        f"{100 * row['gain']:.1f} %: check the records, or choose another family"
    )
