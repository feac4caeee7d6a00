"""Figures of merit of an identified model on records, and noise and whiteness of the residual."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hyst_control.chain.stage import Array
from hyst_control.identify.dataset import Dataset, RecordRow
from hyst_control.identify.fit_windows import before
from hyst_control.model_file import Model, simulate
from hyst_control.records.session_zero import without_zero


def residual(model: Model, data: Dataset) -> Array:
    """Measured minus simulated output.

    Rows before the hysteresis memory is filled are left out where the record's start is unknown.

    Parameters
    ----------
    model
        The model.
    data
        The record.

    Returns
    -------
    Array
        Residual (N, A) in the measurement unit.
    """
    memory, begin = before(data)
    command = data.command if memory is None else np.concatenate([memory, data.command])
    simulated = simulate(model, command, data.sample_time, data.hold)[len(command) - len(data.command) :]
    return data.measurement[begin:] - simulated[begin:]


def record_rows(model: Model, datasets: Sequence[Dataset]) -> tuple[list[RecordRow], list[Array]]:
    """Score a model on records.

    Parameters
    ----------
    model
        The model.
    datasets
        The records.

    Returns
    -------
    rows : list of RecordRow
        One row per record and axis: rmse in the measurement unit; nrmse and nme in % of the measured range (HAMPI paper Eq. 26, MHL
        paper Eq. 10); nrmse_centered the same with the means removed; nrmse_own_zero with the record's own zero, drift and curvature
        removed, which stand beside it.
    residuals : list of Array
        Measured minus simulated (N, A) per record.
    """
    rows: list[RecordRow] = []
    residuals = []
    for data in datasets:
        error = residual(model, data)
        residuals.append(error)
        rest, own = without_zero(error)
        for axis, name in enumerate(data.axes):
            span = float(data.range[axis]) or 1.0
            e = error[:, axis]
            rows.append(
                {
                    "name": data.name,
                    "axis": name,
                    "samples": len(e),
                    "rmse": float(np.sqrt(np.mean(e**2))),
                    "nrmse": 100.0 * float(np.sqrt(np.mean(e**2))) / span,
                    "nrmse_centered": 100.0 * float(np.std(e)) / span,
                    "nrmse_own_zero": 100.0 * float(np.sqrt(np.mean(rest[:, axis] ** 2))) / span,
                    "zero": float(own[axis, 0]),
                    "drift": float(own[axis, 1]),
                    "curvature": float(own[axis, 2]),
                    "nme": 100.0 * float(np.max(np.abs(e))) / span,
                    "unit": data.unit,
                    "whiteness": lag_one(e),
                }
            )
    return rows, residuals


def lag_one(error: Array) -> float:
    """Correlation of neighboring residuals: 0 for white noise, near 1 where the model lacks something slow.

    Parameters
    ----------
    error
        Residual (N,).

    Returns
    -------
    float
        Correlation, -1 to 1.
    """
    centered = error - np.mean(error)
    power = float(centered @ centered)
    return float(centered[1:] @ centered[:-1]) / power if power > 0 else 0.0


def noise_sigma(residuals: Sequence[Array]) -> list[float]:
    """Estimate the white noise in residuals from their third differences, to which smooth model errors contribute little.

    Parameters
    ----------
    residuals
        Residuals (N, A) of every record.

    Returns
    -------
    list[float]
        Noise (A), rms in the measurement unit.
    """
    stacked = np.concatenate([np.diff(error, 3, axis=0) for error in residuals])
    return [float(value) for value in np.median(np.abs(stacked), axis=0) / 0.6745 / np.sqrt(20.0)]


def command_bandwidth(data: Dataset) -> float:
    """Frequency below which 99.9 % of the power of the command's motion lies.

    Parameters
    ----------
    data
        The record.

    Returns
    -------
    float
        Frequency, Hz.
    """
    moving = data.command - data.command.mean(axis=0)
    power = np.sum(np.abs(np.fft.rfft(moving, axis=0)) ** 2, axis=1)
    if power.sum() == 0:
        return 0.0
    cumulative = np.cumsum(power) / power.sum()
    return float(np.searchsorted(cumulative, 0.999) / (len(moving) * data.sample_time))
