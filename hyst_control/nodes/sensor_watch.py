"""Detection of a sensor that is frozen or out of range."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MOTION = 0.01
"""Share of the command's range by which the command must move before a constant measurement counts as frozen."""


class MeasurementWatch:
    """Watch over a measurement, sample by sample.

    Parameters
    ----------
    lower, upper : float
        Range of the measurement, in its unit.
    frozen_ticks : int
        Samples of equal value after which the sensor counts as frozen; 0 for never.
    motion : float
        Movement of the command in V before they are counted, because a stage at rest may measure a constant.
    """

    def __init__(self, lower: float, upper: float, frozen_ticks: int, motion: float) -> None:
        self.lower, self.upper = lower, upper
        self.frozen_ticks, self.motion = frozen_ticks, motion
        self._value: list[float] = []
        self._same = 0
        self._least: list[float] = []
        self._most: list[float] = []

    def check(self, measurement: Array, command: Array) -> str:
        """Check one sample.

        Parameters
        ----------
        measurement : ndarray, shape (A,)
            The measurement, in the unit of `lower` and `upper`.
        command : ndarray, shape (A,)
            The command sent last, in V.

        Returns
        -------
        str
            The fault; "" when there is none.
        """
        value, sent = measurement.tolist(), command.tolist()
        if value != self._value:
            self._value, self._same, self._least, self._most = value, 0, sent, sent
        else:
            self._least, self._most = list(map(min, self._least, sent)), list(map(max, self._most, sent))
            if max(most - least for most, least in zip(self._most, self._least)) > self.motion:
                self._same += 1
        if min(value) < self.lower or max(value) > self.upper:
            return "measurement out of range"
        if 0 < self.frozen_ticks <= self._same:
            return "measurement frozen"
        return ""
