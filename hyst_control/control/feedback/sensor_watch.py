# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Detection of a sensor that is out of range, does not answer its command, or answers with the wrong sign, axis by axis.

*No answer.* The command moved by `MOTION` of its range, and for the frozen time since the measurement has stayed within a share `STILL` of
the mean error that the loop was to take away. The digit that flickers at the end of a dead sensor is much less than that. The deviation
that is left of a disturbance is much more: the error is that very deviation. A command that moves more slowly, as against a drift, is
no question that could be left without an answer. A sensor that was found dead lives again once it moves by `ALIVE` times what it
flickered by: at the safe value nothing is asked of it that an answer could be measured by.

*Wrong sign.* Measurement and command pass the same low-pass. The ratio of the ranges that they cover is the gain, whatever its sign and
the lag between them. Once the command has moved in one direction by `AGAINST` and the measurement, from each `MOTION` to the next, the
other way by half to twice the gain, the sign has turned: the command runs away. A jump of the measurement is none of the command's
doing, and what comes after it is judged by itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated

from hyst_control.base.arrays import Array

MOTION = 0.01  # Share of the command's range by which the command must move before the measurement is judged
STILL = 0.02  # Share of the mean error
ALIVE = 3.0  # Largest flickers of a dead sensor
AGAINST = 8.0
"""Movements of the command, in `MOTION`, that teach the gain, and against which the measurement has gone when its sign has turned."""
JUMP = 5.0  # Movements of the command, in `MOTION`, of which the answer within a tick is a jump of the measurement
SLOW = 3  # Frozen times within which the command must move before a constant measurement counts as frozen
FORGOTTEN = 0.02  # Share of what the present values leave of a range that is forgotten with every movement

FROZEN, OUT_OF_RANGE, TURNED = "measurement frozen", "measurement out of range", "measurement moves against the command"


def smoothing_share(frozen_ticks: int) -> float:
    """Share of a step that the low-passes let pass in a tick: their time constant is a fifth of the frozen time."""
    return -math.expm1(-5.0 / max(frozen_ticks, 1))


class MeasurementWatch:
    """Watch over a measurement, sample by sample and axis by axis."""

    def __init__(
        self, lower: float, upper: float, frozen_ticks: int, motion: float, limits: tuple[float, float] = (-math.inf, math.inf)
    ) -> None:
        self.lower, self.upper = lower, upper
        self.frozen_ticks, self.motion, self.limits = frozen_ticks, motion, limits
        self._axes: list[_Axis] = []

    def judge_by(self, other: MeasurementWatch) -> None:
        """Go on with the range and the times of an `other` watch."""
        self.lower, self.upper, self.limits = other.lower, other.upper, other.limits
        self.frozen_ticks, self.motion = other.frozen_ticks, other.motion

    def forget(self) -> None:
        """Begin anew: what was measured before is no answer to the command."""
        self._axes = []

    def check(
        self, measurement: Annotated[Array, "A"], command: Annotated[Array, "A"], reference: Array | None = None
    ) -> tuple[str, ...]:
        """Check one sample."""
        values, sent = measurement.tolist(), command.tolist()
        wanted = values if reference is None else reference.tolist()
        if len(self._axes) != len(values):
            self._axes = [_Axis() for _ in values]
        share = smoothing_share(self.frozen_ticks)
        found = [self._look(*each, share) for each in zip(self._axes, values, sent, wanted)]
        return tuple(found) if any(found) else ()

    def _look(self, axis: _Axis, value: float, volts: float, wanted: float, share: float) -> str:
        """Fault of an axis with its newest sample, "" for none."""
        if not self.lower <= value <= self.upper:
            return OUT_OF_RANGE
        if not self.frozen_ticks or math.isnan(volts):
            return ""
        if axis.same < self.frozen_ticks:  # of a frozen one it is kept: at the safe value nothing more is asked for
            lowest, highest = self.limits
            error, span, reach = abs(wanted - value), self.upper - self.lower, axis.gain * (highest - lowest)
            # Of a reference out of reach no more counts than the stage can move: else no motion would be an answer.
            span = reach if 0.0 < reach < span else span
            error = (error if error < span else span) if lowest < volts < highest else 0.0
            axis.error += share * (error - axis.error)
        self._look_for_an_answer(axis, value, volts)
        self._look_at_the_sign(axis, value, volts, share)
        if axis.same >= self.frozen_ticks:
            return FROZEN
        return TURNED if abs(axis.against) >= AGAINST * self.motion else ""

    def _look_for_an_answer(self, axis: _Axis, value: float, volts: float) -> None:
        moved, still = abs(value - axis.value), STILL * axis.error
        if axis.same < self.frozen_ticks:
            axis.flicker = moved if axis.flicker < moved <= still else axis.flicker
        else:
            still = min(still, ALIVE * axis.flicker)
        if not moved <= still:  # it has moved, or is the first one
            axis.value, axis.same, axis.waited, axis.least, axis.most = value, 0, 0, volts, volts
            axis.flicker = 0.0
            return
        axis.least, axis.most = min(axis.least, volts), max(axis.most, volts)
        if axis.most - axis.least > self.motion:
            axis.same += 1
            return
        axis.waited += 1
        if axis.waited > SLOW * self.frozen_ticks:
            axis.waited, axis.least, axis.most = 0, volts, volts

    def _look_at_the_sign(self, axis: _Axis, value: float, volts: float, share: float) -> None:
        allowed = axis.gain * (JUMP * self.motion + 3.0 * abs(volts - axis.volts))
        if math.isnan(axis.last) or axis.gain > 0.0 and abs(value - axis.last) > allowed:
            axis.restart(value, volts)
        axis.last = value
        axis.volts += share * (volts - axis.volts)
        axis.smooth += share * (value - axis.smooth)
        axis.age += 1
        moved, turned = axis.volts - axis.volts_before, AGAINST * self.motion
        if abs(moved) >= self.motion:
            answer = -(axis.smooth - axis.smooth_before) / moved
            if not 0.5 * axis.gain <= answer <= 2.0 * axis.gain or axis.gain == 0.0:
                axis.against = 0.0
            elif abs(axis.against) < turned:
                axis.against = moved + (axis.against if axis.against * moved > 0.0 else 0.0)
        elif axis.age < self.frozen_ticks:
            return
        elif abs(axis.against) < turned:  # slower than that it is a drift
            axis.against = 0.0
        axis.volts_before, axis.smooth_before, axis.age = axis.volts, axis.smooth, 0
        covered = axis.covered.widened(axis.volts)
        answered = axis.answered.widened(axis.smooth)
        if covered >= turned:
            axis.gain = answered / covered


class _Range:
    """Range that values cover, which forgets old ones."""

    __slots__ = ("least", "most")

    def __init__(self, value: float) -> None:
        self.least = self.most = value

    def widened(self, value: float) -> float:
        """Width of the range with a further value."""
        self.least = min(value, self.least + FORGOTTEN * (value - self.least))
        self.most = max(value, self.most + FORGOTTEN * (value - self.most))
        return self.most - self.least


@dataclass(slots=True)
class _Axis:
    """What the watch knows of an axis."""

    error: float = 0.0
    gain: float = 0.0
    value: float = math.nan  # around which the measurement stays
    flicker: float = 0.0  # largest distance from it
    # V, of the command meanwhile
    least: float = 0.0
    most: float = 0.0
    # Ticks since the command has moved, and before it has
    same: int = 0
    waited: int = 0
    last: float = math.nan
    smooth: float = math.nan
    smooth_before: float = math.nan
    volts: float = math.nan
    volts_before: float = math.nan
    answered: _Range = field(default_factory=lambda: _Range(math.nan))
    covered: _Range = field(default_factory=lambda: _Range(math.nan))
    age: int = 0
    against: float = 0.0

    def restart(self, value: float, volts: float) -> None:
        """Judge the sign from here on."""
        self.smooth = self.smooth_before = value
        self.volts = self.volts_before = volts
        self.answered, self.covered = _Range(value), _Range(volts)
        self.age, self.against = 0, 0.0
