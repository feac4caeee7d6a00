"""Records cut into gapless pieces of command and measurement, and the model and report of a fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypedDict

import numpy as np

from hyst_control.base.errors import InputError
from hyst_control.chain.stage import Array
from hyst_control.model_file import Model
from hyst_control.records.stream.row_store import all_finite


@dataclass(frozen=True)
class Beginning:
    """Memory with which a record begins, other than rest at 0 V.

    Parameters
    ----------
    assumed
        In words.
    memory
        Commands (M, A) that precede the record, V; None where none are known.
    row
        First row that counts.
    """

    assumed: str
    memory: Array | None
    row: int


@dataclass(frozen=True)
class Dataset:
    """A gapless, uniformly sampled record of command and measurement.

    Parameters
    ----------
    name
        Name of the record, for messages.
    command
        Commands (N, A) in V.
    measurement
        Measurements (N, A) in `unit`.
    sample_time
        Sample time, s.
    axes
        Names of the A axes.
    unit
        Unit of the measurement.
    hold
        Command between ticks: "zoh" (held) or "foh" (straight).
    start
        "settled": the record begins at rest at its first command, reached from 0 V on the virgin curve; "unknown": an identification
        lets the hysteresis memory fill before it counts the error; "auto": found from the record by `identify`.
    beginning
        Memory at an unknown start, as found from the record.
    command_unit
        Unit of the command, where it is not V.
    """

    name: str
    command: Array
    measurement: Array
    sample_time: float
    axes: tuple[str, ...]
    unit: str
    hold: str = "zoh"
    start: str = "settled"
    beginning: Beginning | None = None
    command_unit: str = "V"

    @property
    def range(self) -> Array:
        """Range (A,) of the measurement, the norm of NRMSE and NME."""
        span: Array = np.ptp(self.measurement, axis=0)
        return span

    def rows(self, begin: int, end: int) -> Dataset:
        """Cut the record; the start of a cut that does not begin at row 0 is unknown.

        Parameters
        ----------
        begin, end
            First row, and the row behind the last one.

        Returns
        -------
        Dataset
            The rows begin ... end - 1.
        """
        return Dataset(
            self.name,
            self.command[begin:end],
            self.measurement[begin:end],
            self.sample_time,
            self.axes,
            self.unit,
            self.hold,
            self.start if begin == 0 else "unknown",
            self.beginning if begin == 0 else None,
            self.command_unit,
        )


def check_records(datasets: Sequence[Dataset], least: int = 50) -> None:
    """Check that records belong to one plant and are usable for identification.

    Parameters
    ----------
    datasets
        The records.
    least
        Samples that each of them must have at least.

    Raises
    ------
    InputError
        There is no record, or one differs in axes or unit, is too short or holds values that are not finite; or the command or
        the measurement of an axis moves in none of them.
    """
    if not datasets:
        raise InputError("no record: give at least one bag with command and measurement")
    first = datasets[0]
    for data in datasets:
        if (data.axes, data.unit, data.command_unit) != (first.axes, first.unit, first.command_unit):
            raise InputError(
                f"{data.name}: axes {', '.join(data.axes)} in {data.unit} of {data.command_unit}, but {first.name} has "
                f"{', '.join(first.axes)} in {first.unit} of {first.command_unit}: give records of one plant"
            )
        if len(data.command) < least:
            raise InputError(f"{data.name}: must have at least {least} samples, got {len(data.command)}: record for longer")
        for topic, values in (("command", data.command), ("measurement", data.measurement)):
            if not all_finite(values):
                row = int(np.flatnonzero(~np.all(np.isfinite(values), axis=1))[0])
                raise InputError(f"{data.name}: {topic}: must be finite, is not in sample {row}: remove it")
    for axis, name in enumerate(first.axes):
        if all(np.ptp(data.command[:, axis]) == 0 for data in datasets):
            raise InputError(f"{first.name}: the command of axis {name} never moves: record an excitation")
        if all(np.ptp(data.measurement[:, axis]) == 0 for data in datasets):
            raise InputError(f"{first.name}: the measurement of axis {name} never moves: check the sensor and the topic")


class RecordRow(TypedDict):
    """Error of a model on one axis of a record.

    Parameters
    ----------
    name
        The record.
    axis
        The axis.
    samples
        Number of rows compared.
    rmse
        Root mean square error, in `unit`.
    nrmse
        RMSE in % of the measured range.
    nrmse_centered
        The same, with the means removed.
    nrmse_own_zero
        The same, with the record's own zero, drift and curvature removed.
    zero, drift, curvature
        These: coefficients of the Legendre polynomials of degree 0, 1 and 2 over the rows compared, in `unit`.
    nme
        Largest error in % of the measured range.
    unit
        Unit of the measurement.
    whiteness
        Correlation of neighboring residuals, 0 for white noise.
    """

    name: str
    axis: str
    samples: int
    rmse: float
    nrmse: float
    nrmse_centered: float
    nrmse_own_zero: float
    zero: float
    drift: float
    curvature: float
    nme: float
    unit: str
    whiteness: float


class BeginningRow(TypedDict):
    """Beginning of a record.

    Parameters
    ----------
    name
        The record.
    assumed
        State that the identification took for its beginning, in words.
    first_row
        First row that counts.
    """

    name: str
    assumed: str
    first_row: int


class _Parameter(TypedDict):
    name: str
    value: float
    standard_error: float | None
    unit: str


class ParameterRow(_Parameter, total=False):
    """A parameter with its standard error.

    Parameters
    ----------
    axis
        The axis.
    threshold
        Threshold of the play operator whose weight it is, V.
    name
        Name, with its index where it is one of a list.
    value
        Value, in `unit`.
    standard_error
        Standard error, in `unit`; None where the data cannot give one.
    unit
        Unit, empty for numbers without one.
    """

    axis: str
    threshold: float


class OrderRow(TypedDict, total=False):
    """A linear model that was tried; errors are rms error / rms measurement.

    Parameters
    ----------
    axis
        The axis, where axes are fitted one by one.
    order
        Number of states asked for.
    states
        Number of states of the model.
    parameters
        Number of free parameters.
    fitted
        Error on the data fitted.
    held_out
        Error on held-out data; None where no data were held out.
    seconds
        Time that the fit took, s.
    delay_samples
        Delay (m,) of every input, samples.
    """

    axis: str
    order: int
    states: int
    parameters: int
    fitted: float
    held_out: float | None
    seconds: float
    delay_samples: list[float]


class StructureRow(TypedDict):
    """A structure of G(s) that was tried.

    Parameters
    ----------
    axis
        The axis.
    structure
        Factors of G(s) in words.
    parameters
        Number of parameters of the axis' model.
    held_out_nrmse
        % of range, on rows that were not fitted.
    chosen
        Whether it is the model's.
    """

    axis: str
    structure: str
    parameters: int
    held_out_nrmse: float
    chosen: bool


class TriedRow(TypedDict):
    """A model family that was tried.

    Parameters
    ----------
    family
        Name of the family.
    structure
        G(s) of each axis in words.
    parameters
        Number of parameters of all axes.
    held_out_nrmse
        % of range of the worst axis, on rows that were not fitted; None where the records do not suit the family.
    seconds
        Time that the fit took, s.
    chosen
        Whether the model is of this family.
    refused
        Reason why the records do not suit the family; "" where they do.
    structures
        Structures of G(s) among which the family chose.
    """

    family: str
    structure: str
    parameters: int
    held_out_nrmse: float | None
    seconds: float
    chosen: bool
    refused: str
    structures: list[StructureRow]


class _Report(TypedDict):
    family: str
    method: str
    unit: str
    records: list[RecordRow]
    parameters: list[ParameterRow]
    notes: list[str]


class Report(_Report, total=False):
    """Errors of a fit and standard errors of its parameters, ready for JSON.

    Parameters
    ----------
    held_out_nrmse
        % of range per axis, on rows that were not fitted.
    structure
        G(s) of each axis in words.
    structures
        Structures of G(s) that were tried.
    tried
        Families that were tried, where none was named.
    steps
        Results of the paper's sequence step by step, per axis.
    orders
        Linear models that were tried.
    states
        Number of states of the chosen linear model.
    bags
        Paths of the bags.
    beginnings
        State that was taken for the beginning of each record.
    verdict
        "explains", "records_disagree" (under the common model), "explains_nothing", or "invalid_record" where the fit was forced.
    explained
        Shares of the measured power that the model explains, and a constant and a gain, a row an axis.
    family, method
        Model family, and "joint" or "paper".
    unit
        Unit of the measurement.
    records
        Errors, a row a record and axis.
    parameters
        Parameters with their standard errors.
    notes
        Sentences on what the data cannot show, with the remedy.
    """

    held_out_nrmse: list[float]
    structure: list[str]
    structures: list[StructureRow]
    tried: list[TriedRow]
    steps: list[dict[str, dict[str, Any]]]
    orders: list[OrderRow]
    states: int
    bags: list[str]
    beginnings: list[BeginningRow]
    verdict: str
    explained: list[Any]


@dataclass(frozen=True)
class Fit:
    """An identified model and its report.

    Parameters
    ----------
    model
        The model.
    report
        Errors on the records and standard errors of the parameters.
    residuals
        Measured minus simulated (N, A) of every record, whose simulation is not repeated; empty where a family does not hand them on.
    """

    model: Model
    report: Report
    residuals: tuple[Array, ...] = ()
