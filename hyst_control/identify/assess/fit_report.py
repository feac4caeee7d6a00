# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Figures of merit of an identified model on records, and noise and whiteness of the residual."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

import numpy as np
from scipy.fft import rfft

from hyst_control.base.arrays import Array
from hyst_control.chain.linear.linear_stages import Delay
from hyst_control.chain.memoryless import Gain, Offset
from hyst_control.identify.assess.free_motion import ROWS as MOTION_ROWS
from hyst_control.identify.assess.free_motion import without_free_motion
from hyst_control.identify.data.fit import RecordRow
from hyst_control.identify.data.fit_windows import before
from hyst_control.identify.data.initial_memory import DOUBT, seems_at_rest
from hyst_control.model_file import Model, simulate
from hyst_control.records.quantization_step import quantization_step
from hyst_control.records.record import Beginning, Record
from hyst_control.records.session_zero import without_zero
from hyst_control.records.stream.row_store import blocks, largest_size, mean_square, spread_parts

NOISE_ROWS, SPECTRUM_ROWS = 2**21, 2**22
"""Rows from which noise and bandwidth are taken: those of longer records in parts spread over them."""

JUMP = "at rest at 0 V, from which the first command jumps"
MOVING = "amid a motion: state of the dynamics estimated"
AT_FIRST = "at rest at the first command"
BEGINNING_ROWS, AT_REST_SHARE, OTHER_SHARE = 4096, 0.5, 0.8
"""First rows that tell whether a record begins so, and the share of their square error, beside a drift, that may be left at most.

The smaller share is for a record whose hysteresis begins at rest: there the error of the first rows is mostly the model's own.
"""
OFFSET_SHARE = 0.02  # Share of the mean square error that a common offset makes where the model states it


def residual(model: Model, data: Record) -> Array:
    """Measured minus simulated output.

    Rows before the hysteresis memory is filled are left out where the record's start is unknown.
    """
    return residual_from(model, with_state(model, with_own_rows(model, data)))


def residual_energy(residuals: Sequence[Array]) -> float:
    """Energy of residuals (N, A), each without its session's zero and drift."""
    return sum(float(np.sum(without_zero(error)[0] ** 2)) for error in residuals)


def with_own_rows(model: Model, data: Record) -> Record:
    """The record with all its rows for a linear model, which has no hysteresis memory to be filled."""
    return replace(data, start=Beginning(AT_FIRST, None, 0)) if is_linear(model) and before(data)[1] else data


def is_linear(model: Model) -> bool:
    """True of a model without hysteresis or curves."""
    return all(stage.linear or isinstance(stage, Delay | Gain | Offset) for stage in model.chain.stages)


def residual_from(model: Model, data: Record) -> Array:
    """The same of a record of which it is known whether its first command jumps, and whether its dynamics move already."""
    memory, begin = before(data)
    error = simulate(model, data.command, data.sample_time, data.hold, memory)[begin:]
    np.subtract(data.measurement[begin:], error, out=error)  # in place: a long record's error is on a file, as its simulation is
    if isinstance(data.start, Beginning) and data.start.moving:
        without_free_motion(model, data, error)
    return error


def with_state(model: Model, data: Record) -> Record:
    """The record, known to begin at rest at 0 V, from which its first command jumps, or amid a motion, if that fits far better.

    A start that the record states is left as it is.
    """
    if data.start == "settled":
        return data
    memory, begin = before(data)
    end = begin + BEGINNING_ROWS
    if begin > BEGINNING_ROWS or not model.chain.stages:
        return data
    first, still = data.rows(0, end), Beginning("", memory, begin)

    def left(start: Beginning) -> tuple[float, float, float]:
        """Mean square error beside the session's zero and drift, beside its zero alone, and as it is."""
        error = residual_from(model, replace(first, start=start))
        beside_zero = float(np.mean((error - error.mean(axis=0)) ** 2))
        return float(np.mean(without_zero(error)[0] ** 2)), beside_zero, float(np.mean(error**2))

    def spoils(start: Beginning) -> bool:
        """True where the estimated motion increases the error of the rows that follow, as a slow one that resembles a drift does."""
        longer = data.rows(0, begin + MOTION_ROWS)
        with_it, without = (float(np.sum(residual_from(model, replace(longer, start=each)) ** 2)) for each in (start, still))
        return with_it > without

    least, share = left(still), AT_REST_SHARE if seems_at_rest(data) else OTHER_SHARE
    others = [Beginning(MOVING, memory, begin, moving=True)]
    if np.any(data.command[0]):
        others.insert(0, Beginning(JUMP, np.zeros((1, len(data.axes))), 0))
    for other in others:
        found = left(other)
        # An integrator settles at no first command but 0 V: a jump leaves as little, without a drift or a zero that takes its wrong rest
        # back.
        as_good = not other.moving and found[0] <= DOUBT * least[0]
        calmer = as_good and (found[1] < share * least[1] or (found[1] <= DOUBT * least[1] and found[2] < share * least[2]))
        if (found[0] < share * least[0] or calmer) and not (other.moving and spoils(other)):
            data, least = replace(data, start=other), found
    return data


def record_rows(model: Model, records: Sequence[Record]) -> tuple[list[RecordRow], list[Array]]:
    """Scores of a model on records, and measured minus simulated (N, A) of each."""
    residuals = [residual(model, data) for data in records]
    return error_rows(records, residuals), residuals


def error_rows(records: Sequence[Record], residuals: Sequence[Array]) -> list[RecordRow]:
    """Scores of residuals (N, A), a row a record and axis.

    rmse in the measurement unit; nrmse and nme in % of the measured range (HAMPI paper Eq. 26, MHL paper Eq. 10); nrmse_centered without
    the mean; nrmse_own_zero without the session's offset, drift and curvature, which stand beside it.
    """
    rows: list[RecordRow] = []
    for data, error in zip(records, residuals, strict=True):
        rest, own = without_zero(error)
        for axis, (name, whole) in enumerate(zip(data.axes, data.span, strict=True)):
            span = float(whole) or 1.0
            e = error[:, axis]
            rows.append(
                {
                    "name": data.name,
                    "axis": name,
                    "samples": len(e),
                    "rmse": float(np.sqrt(mean_square(e))),
                    "nrmse": 100.0 * float(np.sqrt(mean_square(e))) / span,
                    "nrmse_centered": 100.0 * float(np.sqrt(mean_square(e, float(np.mean(e))))) / span,
                    "nrmse_own_zero": 100.0 * float(np.sqrt(mean_square(rest[:, axis]))) / span,
                    "zero": float(own[axis, 0]),
                    "drift": float(own[axis, 1]),
                    "curvature": float(own[axis, 2]),
                    "nme": 100.0 * largest_size(e) / span,
                    "unit": data.unit,
                    "whiteness": lag_one(e),
                }
            )
    return rows


def with_offset(model: Model, residuals: Sequence[Array], span: Array, least: float) -> Model:
    """The model with the sensor's common offset as its last stage, which is taken off its residuals (N, A) in place.

    A smaller offset than the share `least` of the range `span` (A,), or one that hardly changes the error, is left to the session.
    """
    offset, square = mean_of(residuals)
    if not np.any((offset**2 > OFFSET_SHARE * square) & (np.abs(offset) > least * span)):
        return model
    for error in residuals:
        np.subtract(error, offset, out=error)
    values = [float(value) for value in offset]
    return model.with_stages([*model.chain.stages, Offset(values[0] if len(set(values)) == 1 else values)])


def mean_of(residuals: Sequence[Array]) -> tuple[Array, Array]:
    """Mean (A,) and mean square (A,) of residuals (N, A) of several records."""
    count = sum(map(len, residuals))
    mean = sum(error[part].sum(axis=0) for error in residuals for part in blocks(len(error))) / count
    square = sum((error[part] ** 2).sum(axis=0) for error in residuals for part in blocks(len(error))) / count
    return np.asarray(mean), np.asarray(square)


def lag_one(error: Array) -> float:
    """Correlation of neighboring residuals: 0 for white noise, near 1 where the model lacks something slow."""
    mean, power, product = np.mean(error), 0.0, 0.0
    for part in blocks(len(error)):
        centered = error[part.start : part.stop + 1] - mean  # one row of the next block, the last block's apart
        own = centered[: part.stop - part.start]
        power += float(own @ own)
        product += float(centered[1:] @ centered[:-1])
    return product / power if power > 0 else 0.0


def noise_sigma(residuals: Sequence[Array], records: Sequence[Record] = ()) -> list[float]:
    """Estimate the white noise in residuals from their third differences, to which smooth model errors contribute little."""
    stacked = np.concatenate(
        [np.diff(error[part], 3, axis=0) for error in residuals for part in spread_parts(len(error), NOISE_ROWS)]
    )
    sigma = np.median(np.abs(stacked), axis=0) / 0.6745 / np.sqrt(20.0)
    for data in records:
        sigma = np.maximum(sigma, [quantization_step(column) / np.sqrt(12.0) for column in data.measurement[:NOISE_ROWS].T])
    return [float(value) for value in sigma]


def command_bandwidth(command: Annotated[Array, "N A"], sample_time: float) -> float:
    """Frequency below which 99.9 % of the power of the command's motion lies."""
    mean, parts = command.mean(axis=0), spread_parts(len(command), SPECTRUM_ROWS)
    length = parts[0].stop
    power = np.zeros(length // 2 + 1)
    motion = np.empty((length, command.shape[1]), np.float32)  # half the memory; its rounding is far below 0.1 % of the power
    for part in parts:
        np.subtract(command[part], mean, out=motion, casting="unsafe")
        for column in motion.T:
            power += np.abs(rfft(column)) ** 2
    if power.sum() == 0:
        return 0.0
    cumulative = np.cumsum(power) / power.sum()
    return float(np.searchsorted(cumulative, 0.999) / (length * sample_time))
