"""Watching a measurement: a sensor that hangs or leaves its range is told from one that measures."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MOTION = 0.01
"""Share of the command's range by which the command must have moved for a resting measurement to count as frozen."""


class MeasurementWatch:
    """Looks at one sample after the other.

    Parameters
    ----------
    lower, upper : float
        Range of the measurement, in its unit.
    frozen_ticks : int
        Samples of one and the same value after which the sensor counts as frozen; 0 for never.
    motion : float
        Way in V that the command must have moved before they are counted: a stage at rest may well measure a constant.
    """

    def __init__(self, lower: float, upper: float, frozen_ticks: int, motion: float) -> None:
        self.lower, self.upper = lower, upper
        self.frozen_ticks, self.motion = frozen_ticks, motion
        self._value: list[float] = []
        self._same = 0
        self._least: list[float] = []
        self._most: list[float] = []

    def check(self, measurement: Array, command: Array) -> str:
        """Empty text for a measurement (A,) that is fine, else what is wrong with it; command (A,): the one sent last, in V."""
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
