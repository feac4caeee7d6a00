# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Judgment of a fit by what its simulation from the command explains, beside what a constant and a gain would."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypedDict

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.records.record import Record
from hyst_control.records.session_zero import basis, without_zero
from hyst_control.records.stream.row_store import blocks, empty_rows

LEAST = 0.1  # Share of a measurement's power, about one zero and drift a record, that a model explains if it explains anything
AS_GOOD = 0.999  # Share from which a model is not held against a gain: both are then within the noise of small records
WORSE = 1.25  # Ratio of the unexplained powers of a model and a gain from which the model explains less

EXPLAINS, POORLY, DISAGREE = "explains", "explains_poorly", "records_disagree"
NOTHING, INVALID = "explains_nothing", "invalid_record"
"""Verdicts on a fit: of use; of use, but much is left; of records that differ under it; of no use, so not written; forced."""


class ExplainedRow(TypedDict):
    """Shares of an axis' measured power that the model's simulation explains, and a gain, each with a zero and a drift a record."""

    axis: str
    model: float
    gain: float


def explained_shares(records: Sequence[Record], errors: Sequence[Array]) -> list[ExplainedRow]:
    """Shares that a model explains of each axis that moves; what its errors show as drift of the session counts for neither side."""
    sums = np.zeros(
        (5, len(records[0].axes))
    )  # of measurement², error², command², command · measurement, measurement beside a drift²
    for data, error in zip(records, errors, strict=True):
        first = len(data.command) - len(error)
        left, session = without_zero(error)
        command, drift = without_zero(data.command[first:])[0], session.T
        measured = empty_rows(*error.shape)
        for part in blocks(len(error)):
            measured[part] = data.measurement[first:][part] - basis(part, len(error)) @ drift
        mean, (beside, _) = np.mean(measured, axis=0), without_zero(measured)
        for part in blocks(len(error)):
            y, e, u, b = measured[part] - mean, left[part], command[part], beside[part]
            sums += [np.sum(own, axis=0) for own in (y * y, e * e, u * u, u * b, b * b)]
    rows: list[ExplainedRow] = []
    for axis, (yy, ee, uu, ub, bb) in zip(records[0].axes, sums.T, strict=True):
        if uu > 0 and yy > 0:
            rows.append({"axis": axis, "model": float(1.0 - ee / yy), "gain": float(1.0 - (bb - ub**2 / uu) / yy)})
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
