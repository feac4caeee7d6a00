# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Judgment of a fit by what its simulation from the command explains, beside what a constant and a gain would."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypedDict

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.records.record import Record
from hyst_control.records.session_zero import basis
from hyst_control.records.stream.row_store import blocks

LEAST = 0.1  # Share of a measurement's power, about one zero and drift a record, that a model explains if it explains anything
AS_GOOD = 0.999  # Share from which a model is not held against a gain: both are then within the noise of small records
WORSE = 1.25  # Ratio of the unexplained powers of a model and a gain from which the model explains less

ROUNDING = 1e-12  # Share of a command's power that is rounding

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
    powers = sum(
        np.array([_powers(data, error, axis) for axis in range(len(data.axes))])
        for data, error in zip(records, errors, strict=True)
    )
    rows: list[ExplainedRow] = []
    for axis, (moved, whole, error, command, product, measured) in zip(records[0].axes, np.asarray(powers), strict=True):
        if moved > 0 and whole > 0:
            by_gain = product**2 / command if command > ROUNDING * moved else 0.0  # a command may itself be a parabola
            rows.append({"axis": axis, "model": float(1.0 - error / whole), "gain": float(1.0 - (measured - by_gain) / whole)})
    return rows


def _powers(data: Record, error: Array, axis: int) -> tuple[float, float, float, float, float, float]:
    """Sums of an axis' command² from the first row on, of measurement² without drift, and four beside the session's parabola."""
    # The four are error², command², command · measurement and measurement².
    count, first, gram = len(error), len(data.command) - len(error), np.zeros((6, 6))
    for part in blocks(count):
        own = slice(first + part.start, first + part.stop)
        command, measured = (signal[own, axis] - signal[first, axis] for signal in (data.command, data.measurement))
        rows = np.column_stack([command, measured, error[part, axis], basis(part, count)])
        gram += rows.T @ rows
    session = np.linalg.lstsq(gram[3:, 3:], gram[3:, :3], rcond=None)[0]
    beside = gram[:3, :3] - gram[:3, 3:] @ session
    settled = np.concatenate([[0.0, 1.0, 0.0], -session[:, 2]])  # the measurement without the error's drift
    whole = settled @ gram @ settled - (settled @ gram[:, 3]) ** 2 / count
    return float(gram[0, 0]), float(whole), float(beside[2, 2]), float(beside[0, 0]), float(beside[0, 1]), float(beside[1, 1])


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
