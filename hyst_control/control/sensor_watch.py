"""Detection of a sensor that is frozen or out of range, axis by axis."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MOTION = 0.01
"""Share of the command's range by which the command must move before a constant measurement counts as frozen."""

FROZEN, OUT_OF_RANGE = "measurement frozen", "measurement out of range"


class MeasurementWatch:
    """Watch over a measurement, sample by sample and axis by axis.

    Parameters
    ----------
    lower, upper : float
        Range of the measurement, in its unit.
    frozen_ticks : int
        Samples of equal value after which an axis' sensor counts as frozen; 0 for never.
    motion : float
        Movement of the axis' command in V before they are counted, because a stage at rest may measure a constant.
    """

    def __init__(self, lower: float, upper: float, frozen_ticks: int, motion: float) -> None:
        self.lower, self.upper = lower, upper
        self.frozen_ticks, self.motion = frozen_ticks, motion
        self._axes: list[_Axis] = []

    def judge_by(self, other: MeasurementWatch) -> None:
        """Go on with the range and the times of an `other` watch."""
        self.lower, self.upper, self.frozen_ticks, self.motion = other.lower, other.upper, other.frozen_ticks, other.motion

    def check(self, measurement: Array, command: Array) -> tuple[str, ...]:
        """Check one sample.

        Parameters
        ----------
        measurement : ndarray, shape (A,)
            The measurement, in the unit of `lower` and `upper`.
        command : ndarray, shape (A,)
            The command sent last, in V.

        Returns
        -------
        tuple of str
            The fault of each axis, "" for none; empty when no axis has one.
        """
        values, sent = measurement.tolist(), command.tolist()
        if len(self._axes) != len(values):
            self._axes = [_Axis() for _ in values]
        faulty = False
        for axis, value, volts in zip(self._axes, values, sent):
            if value != axis.value:
                axis.value, axis.same, axis.least, axis.most = value, 0, volts, volts
            else:
                if volts < axis.least:
                    axis.least = volts
                elif volts > axis.most:
                    axis.most = volts
                if axis.most - axis.least > self.motion:
                    axis.same += 1
            faulty = faulty or not self.lower <= value <= self.upper or 0 < self.frozen_ticks <= axis.same
        return tuple(self._fault(axis) for axis in self._axes) if faulty else ()

    def _fault(self, axis: _Axis) -> str:
        if not self.lower <= axis.value <= self.upper:
            return OUT_OF_RANGE
        return FROZEN if 0 < self.frozen_ticks <= axis.same else ""


class _Axis:
    """An axis' newest value, how many samples have repeated it since the command moved, and the command's range meanwhile in V."""

    __slots__ = ("least", "most", "same", "value")

    def __init__(self) -> None:
        self.value, self.same, self.least, self.most = float("nan"), 0, 0.0, 0.0
