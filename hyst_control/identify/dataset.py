"""Records cut into gapless pieces of command and measurement, and the model and report that come of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypedDict

import numpy as np

from hyst_control.chain.stage import Array
from hyst_control.errors import InputError
from hyst_control.model_file import Model


@dataclass(frozen=True)
class Dataset:
    """A gapless record: command (N, A) in V and measurement (N, A), uniformly sampled.

    `start` says whether the record begins settled at its first command ("settled") or in the middle of something ("unknown"):
    an identification then lets the hysteresis memory fill before it counts the error.
    """

    name: str
    command: Array
    measurement: Array
    sample_time: float
    axes: tuple[str, ...]
    unit: str
    hold: str = "zoh"
    start: str = "settled"

    @property
    def range(self) -> Array:
        """Range (A,) of the measurement, the norm of NRMSE and NME."""
        span: Array = np.ptp(self.measurement, axis=0)
        return span

    def rows(self, begin: int, end: int) -> Dataset:
        """A cut of the record; unless it begins at row 0 its start is unknown."""
        return Dataset(
            self.name,
            self.command[begin:end],
            self.measurement[begin:end],
            self.sample_time,
            self.axes,
            self.unit,
            self.hold,
            self.start if begin == 0 else "unknown",
        )


def check_records(datasets: Sequence[Dataset], least: int = 50) -> None:
    """Check that records belong to one plant and can tell something about it.

    Parameters
    ----------
    datasets
        The records.
    least
        Samples that each of them must have at least.

    Raises
    ------
    InputError
        There is no record, or one differs in axes or unit, is too short or holds values that are no finite numbers; or the command or
        the measurement of an axis moves in none of them.
    """
    if not datasets:
        raise InputError("no record: give at least one bag with command and measurement")
    first = datasets[0]
    for data in datasets:
        if data.axes != first.axes or data.unit != first.unit:
            raise InputError(
                f"{data.name}: axes {', '.join(data.axes)} in {data.unit}, but {first.name} has "
                f"{', '.join(first.axes)} in {first.unit}: give records of one plant"
            )
        if len(data.command) < least:
            raise InputError(f"{data.name}: {len(data.command)} samples, at least {least} are needed")
        for topic, values in (("command", data.command), ("measurement", data.measurement)):
            if not np.all(np.isfinite(values)):
                row = int(np.flatnonzero(~np.all(np.isfinite(values), axis=1))[0])
                raise InputError(f"{data.name}: {topic}: not a finite number in sample {row}: cut it out first")
    for axis, name in enumerate(first.axes):
        if all(np.ptp(data.command[:, axis]) == 0 for data in datasets):
            raise InputError(f"{first.name}: the command of axis {name} never moves: record an excitation")
        if all(np.ptp(data.measurement[:, axis]) == 0 for data in datasets):
            raise InputError(f"{first.name}: the measurement of axis {name} never moves: check the sensor and the topic")


class RecordRow(TypedDict):
    """Error of a model on one axis of a record: rmse in the unit, nrmse and nme in % of the measured range."""

    name: str
    axis: str
    samples: int
    rmse: float
    nrmse: float
    nrmse_centered: float
    nme: float
    unit: str
    whiteness: float


class _Parameter(TypedDict):
    name: str
    value: float
    standard_error: float | None
    unit: str


class ParameterRow(_Parameter, total=False):
    """A parameter with its standard error (None where the data cannot give one)."""

    axis: str
    threshold: float


class OrderRow(TypedDict, total=False):
    """A linear model that was tried; errors relative to the measurement, held_out None where nothing was held out."""

    axis: str
    order: int
    states: int
    parameters: int
    fitted: float
    held_out: float | None
    seconds: float
    delay_samples: list[float]


class _Report(TypedDict):
    family: str
    method: str
    unit: str
    records: list[RecordRow]
    parameters: list[ParameterRow]
    notes: list[str]


class Report(_Report, total=False):
    """Errors of a fit and standard errors of its parameters, ready for JSON.

    held_out_nrmse: % of range per axis on rows that were not fitted; structure: G(s) of each axis in words; steps: what the paper's
    sequence found on its way, per axis; orders, states: linear models that were tried, and the chosen one's size; bags: their paths.
    """

    held_out_nrmse: list[float]
    structure: list[str]
    steps: list[dict[str, dict[str, Any]]]
    orders: list[OrderRow]
    states: int
    bags: list[str]


@dataclass(frozen=True)
class Fit:
    """An identified model, and the report that says how good it is and how sure its parameters are."""

    model: Model
    report: Report
