"""What every identification works on: records cut into gapless pieces of command and measurement."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hyst_control.chain.stage import Array
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
        return np.ptp(self.measurement, axis=0)

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


@dataclass(frozen=True)
class Fit:
    """An identified model, and the report that says how good it is and how sure its parameters are.

    `report` is JSON-ready: {"family", "method", "records": [{"name", "nrmse", "nme", "rmse", "unit", …}], "parameters":
    [{"name", "value", "standard_error", "unit"}], "notes": [sentences], …}.
    """

    model: Model
    report: dict[str, Any] = field(default_factory=dict)
