# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Checks of the records of a fit, and its model and report."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypedDict

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.model_file import Model
from hyst_control.records.record import Record
from hyst_control.records.stream.row_store import all_finite


def check_records(records: Sequence[Record], least: int = 50) -> None:
    """Check that records belong to one plant, have no gaps and are usable for identification."""
    if not records:
        raise InputError("no record: give at least one bag with command and measurement")
    first = records[0]
    for data in records:
        data.check_axes()
        if (data.axes, data.unit, data.command_unit) != (first.axes, first.unit, first.command_unit):
            raise InputError(
                f"{data.name}: axes {', '.join(data.axes)} in {data.unit} of {data.command_unit}, but {first.name} has "
                f"{', '.join(first.axes)} in {first.unit} of {first.command_unit}: give records of one plant"
            )
        if len(data.command) < least:
            remedy = "record for longer" if len(data.command) >= len(data.axes) else "rows are samples: transpose the arrays"
            raise InputError(f"{data.name}: must have at least {least} samples, got {len(data.command)}: {remedy}")
        if not data.is_gapless:
            raise InputError(
                f"{data.name}: command and measurement do not have every tick of one clock: give what `aligned` makes of it"
            )
        for topic, values in (("command", data.command), ("measurement", data.measurement)):
            if not all_finite(values):
                row = int(np.flatnonzero(~np.all(np.isfinite(values), axis=1))[0])
                raise InputError(f"{data.name}: {topic}: must be finite, is not in sample {row}: remove it")
    for axis, name in enumerate(first.axes):
        if all(np.ptp(data.command[:, axis]) == 0 for data in records):
            raise InputError(f"{first.name}: the command of axis {name} never moves: record an excitation")
        if all(np.ptp(data.measurement[:, axis]) == 0 for data in records):
            raise InputError(f"{first.name}: the measurement of axis {name} never moves: check the sensor and the topic")


class RecordRow(TypedDict):
    """Error of a model on one axis of a record."""

    name: str  # The record
    axis: str  # The axis
    samples: int  # Number of rows compared
    rmse: float  # Root mean square error, in `unit`
    nrmse: float  # RMSE in % of the measured range
    nrmse_centered: float  # The same, with the means removed
    nrmse_own_zero: float  # The same, with the record's own zero, drift and curvature removed
    # zero, drift, curvature: These: coefficients of the Legendre polynomials of degree 0, 1 and 2 over the rows compared, in `unit`
    zero: float
    drift: float
    curvature: float
    nme: float  # Largest error in % of the measured range
    unit: str  # Unit of the measurement
    whiteness: float  # Correlation of neighboring residuals, 0 for white noise


class BeginningRow(TypedDict):
    """Beginning of a record."""

    name: str  # The record
    assumed: str  # State that the identification took for its beginning, in words
    first_row: int  # First row that counts


class _Parameter(TypedDict):
    name: str
    value: float
    standard_error: float | None
    unit: str


class ParameterRow(_Parameter, total=False):
    """A parameter with its standard error."""

    axis: str  # The axis
    threshold: float  # Threshold of the play operator whose weight it is, V


class Number(NamedTuple):
    """A number of a report."""

    name: str
    value: float
    unit: str = ""
    estimated: bool = True  # Whether it has a standard error
    threshold: float | None = None  # Of the play operator whose weight it is, V


class OrderRow(TypedDict, total=False):
    """A linear model that was tried; errors are rms error / rms measurement."""

    axis: str  # The axis, where axes are fitted one by one
    order: int  # Number of states asked for
    states: int  # Number of states of the model
    parameters: int  # Number of free parameters
    fitted: float  # Error on the data fitted
    held_out: float | None  # Error on held-out data; None where no data were held out
    seconds: float  # Time that the fit took, s
    delay_samples: list[float]  # Delay (m,) of every input, samples


class StructureRow(TypedDict):
    """A structure of G(s) that was tried."""

    axis: str  # The axis
    structure: str  # Factors of G(s) in words
    parameters: int  # Number of parameters of the axis' model
    held_out_nrmse: float  # % of range, on rows that were not fitted
    chosen: bool  # Whether it is the model's


class TriedRow(TypedDict):
    """A model family that was tried."""

    family: str  # Name of the family
    structure: str  # G(s) of each axis in words
    parameters: int  # Number of parameters of all axes
    # % of range of the worst axis, on rows that were not fitted; None where the records do not suit the family
    held_out_nrmse: float | None
    seconds: float  # Time that the fit took, s
    chosen: bool  # Whether the model is of this family
    refused: str  # Reason why the records do not suit the family; "" where they do
    structures: list[StructureRow]  # Structures of G(s) among which the family chose


class _Report(TypedDict):
    family: str
    method: str
    unit: str
    records: list[RecordRow]
    parameters: list[ParameterRow]
    notes: list[str]


class Report(_Report, total=False):
    """Errors of a fit and standard errors of its parameters, ready for JSON."""

    held_out_nrmse: list[float]  # % of range per axis, on rows that were not fitted
    structure: list[str]  # G(s) of each axis in words
    structures: list[StructureRow]  # Structures of G(s) that were tried
    tried: list[TriedRow]  # Families that were tried, where none was named
    steps: list[dict[str, dict[str, Any]]]  # Results of the paper's sequence step by step, per axis
    orders: list[OrderRow]  # Linear models that were tried
    states: int  # Number of states of the chosen linear model
    bags: list[str]  # Paths of the bags
    beginnings: list[BeginningRow]  # State that was taken for the beginning of each record
    # "explains", "records_disagree" (under the common model), "explains_nothing", or "invalid_record" where the fit was forced
    verdict: str
    # Shares of the measured power that the model explains, and a constant and a gain, a row an axis
    explained: list[Any]
    losses: list[dict[str, Any]]  # Rows sent, received and missed, by record and topic


@dataclass(frozen=True)
class Fit:
    """An identified model and its report."""

    model: Model  # The model
    report: Report  # Errors on the records and standard errors of the parameters
    # Measured minus simulated (N, A) of every record, whose simulation is not repeated; empty where a family does not hand them on
    residuals: tuple[Array, ...] = ()
