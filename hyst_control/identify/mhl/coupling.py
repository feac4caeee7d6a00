# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Cross-coupling between the axes of a model whose axes were identified one by one: y_i = y0_i + Σ M_ij L(s) y0_j.

What an axis does not explain of its measurement is compared with what the other axes do, low-passed at a corner that all share.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.parallel import map_forked
from hyst_control.chain import Chain, Sampling
from hyst_control.chain.linear.linear_stages import CrossCoupling, TransferFunction
from hyst_control.identify.data.fit import ParameterRow
from hyst_control.identify.data.fit_windows import before, first_motion, virgin_rows
from hyst_control.identify.solve.bounded_least_squares import covariance
from hyst_control.model_file import Model, simulate
from hyst_control.records.record import Record
from hyst_control.records.stream.row_store import blocks as row_blocks
from hyst_control.records.stream.row_store import empty_rows

CORNERS = (None, 30.0, 60.0, 100.0, 150.0, 220.0, 320.0, 470.0, 700.0, 1000.0, 2000.0)
"""Corners (Hz) that are tried; none is a static coupling."""
BLOCKS, ROWS = 90, 200_000
WORTHWHILE = 0.03  # The coupling is kept when it lowers some axis' held-out mean square error by more than this share


@dataclass(frozen=True)
class Coupling:
    """matrix (A, A) with ones on its diagonal, its standard errors, and the corner in Hz or None."""

    matrix: Array
    errors: Array
    corner: float | None

    @property
    def stage(self) -> CrossCoupling:
        """The stage at the end of the chain."""
        return CrossCoupling(self.matrix, self.corner)

    def rows(self, axes: Sequence[str]) -> list[ParameterRow]:
        """Report rows of the entries off the diagonal, for `axes` (A,), the names of the axes."""
        return [
            {
                "name": f"matrix[{i}][{j}]",
                "value": float(self.matrix[i, j]),
                "standard_error": float(self.errors[i, j]),
                "unit": "",
                "axis": name,
            }
            for i, name in enumerate(axes)
            for j in range(len(axes))
            if i != j
        ]


def fit_coupling(model: Model, records: Sequence[Record], near: Coupling | None = None) -> Coupling | None:
    """Look for coupling between the axes of a model that has none."""
    simulated = [simulated_rows(model, data) for data in records]
    count = len(model.axes)
    corners: tuple[float | None, ...] = CORNERS if near is None else (near.corner,)
    if near is not None and near.corner is not None:
        corners = tuple(near.corner * factor for factor in (0.85, 1.0, 1.18))
    fastest = 0.4 / max(data.sample_time for data in records)
    slow_enough = [corner for corner in corners if corner is None or corner <= fastest]

    def tried(index: int) -> tuple[float, Coupling, bool]:
        corner = slow_enough[index]
        others = [low_passed(y, corner, data.sample_time) for y, data in zip(simulated, records, strict=True)]
        matrix, errors, share, worthwhile = np.eye(count), np.zeros((count, count)), 0.0, False
        for i in range(count):
            found, spread, without, held_out = regress(i, others, simulated, records)
            matrix[i, np.arange(count) != i], errors[i, np.arange(count) != i] = found, spread
            share += held_out / max(without, 1e-300)
            worthwhile |= held_out < (1.0 - WORTHWHILE) * without
        return share, Coupling(matrix, errors, corner), worthwhile

    best = min(map_forked(tried, len(slow_enough)), key=lambda trial: trial[0])
    return best[1] if best[2] else None


def without_coupling(model: Model, coupling: Coupling, records: Sequence[Record]) -> list[Record]:
    """Records with the other axes' share of each measurement subtracted."""
    cleaned = []
    for data in records:
        y = simulated_rows(model, data)
        passed, others = low_passed(y, coupling.corner, data.sample_time), (coupling.matrix - np.eye(len(model.axes))).T
        measurement = empty_rows(*data.measurement.shape)
        for part in row_blocks(len(measurement)):
            measurement[part] = data.measurement[part] - passed[part] @ others
        cleaned.append(data.with_values(measurement=measurement))
    return cleaned


def simulated_rows(model: Model, data: Record) -> Array:
    """Output (N, A) of the model for the record `data`, in the measurement unit; an unknown start is simulated from its memory."""
    memory, _ = before(data)
    return simulate(model, data.command, data.sample_time, data.hold, memory)


def low_passed(signal: Annotated[Array, "N A"], corner: float | None, sample_time: float) -> Array:
    """Signal behind a first-order low-pass that is settled at its first row."""
    if corner is None:
        return signal
    w = 2.0 * np.pi * corner
    running = Chain((TransferFunction([w], [1.0, w]),)).filter(Sampling(sample_time, signal.shape[1], "foh"))
    running.settle(signal[0])
    passed = empty_rows(*signal.shape)
    for part in row_blocks(len(signal)):
        passed[part] = running.process(signal[part])
    return passed


def regress(
    axis: int, others: Sequence[Array], simulated: Sequence[Array], records: Sequence[Record]
) -> tuple[Array, Array, float, float]:
    """Coupling into one axis (A - 1,), its standard errors, and the held-out square sums of the error without and with it.

    Every record's offset and drift are removed first. Rows on the axis' own virgin curve are left out, and the zero may differ
    after it. Every third block of rows is held out.
    """
    grams = []
    for other, own, data in zip(others, simulated, records, strict=True):
        _, skip = before(data)
        n = len(own)
        # A fraction of the rows says as much: what limits the coupling is how much the axes have in common.
        every = max(n * len(records) // ROWS, 1)
        taken = slice(skip, None, every)
        columns = np.column_stack([np.delete(other[taken], axis, axis=1), data.measurement[taken, axis] - own[taken, axis]])
        first, virgin = first_motion(data.command[:, axis]), virgin_rows(data.command[:, axis])
        rows = np.arange(skip, n, every)
        counted = (rows < first) | (rows >= virgin)
        trend = np.column_stack([np.ones(len(rows)), rows / max(n - 1, 1) - 0.5, rows >= virgin])[counted]
        columns = columns[counted]
        columns = columns - trend @ np.linalg.lstsq(trend, columns, rcond=None)[0]
        grams += [block.T @ block for block in np.array_split(columns, min(BLOCKS, len(columns)))]
    blocks = np.array(grams)
    held_out = np.arange(len(blocks)) % 3 == 2
    fitted = blocks[~held_out].sum(axis=0)
    found = np.linalg.lstsq(fitted[:-1, :-1], fitted[:-1, -1], rcond=1e-9)[0]
    vector = np.append(found, -1.0)
    other = blocks[held_out].sum(axis=0)
    everything = blocks.sum(axis=0)
    final = np.linalg.lstsq(everything[:-1, :-1], everything[:-1, -1], rcond=1e-9)[0]
    errors = np.sqrt(np.maximum(np.diag(covariance(blocks, final)), 0.0))
    return final, errors, float(other[-1, -1]), float(vector @ other @ vector)
