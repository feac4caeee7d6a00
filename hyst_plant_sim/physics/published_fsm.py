# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The published MHL model (fast steering mirror, two axes) as a plant, independent of the simulator's code.

Delay, Madelung hysteresis between the published major branches (MHL paper Eq. 2, Table 1), rate part
Ψ = (k1 v̇ + b1) / (k2 s + b2) in parallel (Eq. 4), dynamics G(s) (Eq. 12), stepped exactly.

Madelung: a list of alternating turning points, the newest last. A branch runs from the newest turning point towards the one
before it, or towards the end of the major loop where there is none; it has the shape of the major branch from the newest
turning point on, scaled so that it arrives. Past its goal both points are forgotten.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import numpy as np
from numba import njit

from hyst_plant_sim.physics.arrays import Array
from hyst_plant_sim.physics.mechanics import mechanics
from hyst_plant_sim.physics.parts import Delay, Held, Sum
from hyst_plant_sim.physics.rational_mechanics import rational
from hyst_plant_sim.physics.signal_path import Frame, Part, PlantError, PlantParameters

DEPTH = 512
"""Most turning points remembered; the oldest pair is forgotten beyond it."""


@dataclass(frozen=True)
class PublishedFsmParameters(PlantParameters):
    """Figures of the published mirror, one entry per axis."""

    axes: ClassVar[tuple[str, ...]] = ("x", "y")
    unit: ClassVar[str] = "mrad"
    internal_rate: ClassVar[float] = 200e3

    delay: Sequence[float]  # Input delay, s
    # ascending, descending: Polynomials p5 … p1 of the major branches over input / span
    ascending: Sequence[Sequence[float]]
    descending: Sequence[Sequence[float]]
    span: Sequence[float]  # Input span, V
    scale: Sequence[float]  # Scale of the output, mrad
    k1: Sequence[float]  # Rate gain, mrad s/V
    k2: Sequence[float]  # Time constant of the rate part, s
    b2: Sequence[float]  # Constant of the rate part's denominator
    # num, den: Polynomials of G(s)
    num: Sequence[Sequence[float]]
    den: Sequence[Sequence[float]]
    noise: float = 0.0  # White noise of both axes, mrad rms

    def __post_init__(self) -> None:
        for name in ("delay", "ascending", "descending", "span", "scale", "k1", "k2", "b2", "num", "den"):
            if not isinstance(getattr(self, name), (list, tuple)) or len(getattr(self, name)) != 2:
                raise PlantError(f"{name}: must be a list of 2 entries, one per axis, got {getattr(self, name)!r}")
        for axis in range(2):
            ends = sum(self.ascending[axis]), sum(self.descending[axis])
            if abs(ends[0] - ends[1]) > 1e-6 * abs(ends[0]):
                raise PlantError(
                    f"descending: axis {self.axes[axis]} ends at {ends[1]:g}, ascending at {ends[0]:g}: scale both alike"
                )

    def parts(self, axis: int, frame: Frame, hysteresis: Mapping[str, float], moving: Mapping[str, Any]) -> dict[str, list[Part]]:
        static = Madelung(
            self.ascending[axis], self.descending[axis], self.span[axis], self.scale[axis], hysteresis.get("width", 0.0)
        )
        rate = hysteresis.get("rate", 1.0) * self.k1[axis] / self.k2[axis]
        pole = self.b2[axis] / self.k2[axis]
        lead = Held((np.array([[-pole]]), np.array([pole]), np.array([-rate]), rate), frame.step)
        delay = Delay(self.delay[axis] + moving.get("delay", 0.0), frame.step)
        return {
            "drive": [delay],
            "hysteresis": [Sum(static, lead)],
            "mechanics": [mechanics(partial(rational, self.num[axis], self.den[axis]), frame, moving, delay.rest)],
        }


class Madelung(Part):
    """Madelung hysteresis, V to mrad. The memory is the deviation from the mean of the two major branches."""

    def __init__(self, ascending: Sequence[float], descending: Sequence[float], span: float, scale: float, width: float) -> None:
        self._up, self._down = np.array(ascending, dtype=float), np.array(descending, dtype=float)
        self._law = np.array([span, scale, width, self._up.sum()])

    def settle(self, value: float) -> float:
        """Start on the ascending branch at the lower end and move to a constant input."""
        self._points = np.zeros((DEPTH, 2))  # begins at the lower end, on the ascending branch
        # input, output of the last step, direction, number of turning points
        self._state = np.array([0.0, 0.0, 1.0, 1.0])
        return float(self.process(np.array([value]))[0])

    def process(self, block: Array) -> Array:
        """Follow the branches along a block."""
        output = np.empty(block.size)
        _madelung(block, self._up, self._down, self._law, self._points, self._state, output)
        return output


@njit(cache=True, error_model="numpy")
def _branch(coefficients: Array, d: float) -> float:
    value = 0.0
    for c in coefficients:
        value = (value + c) * d
    return value


@njit(cache=True, error_model="numpy")
def _madelung(block: Array, up: Array, down: Array, law: Array, points: Array, state: Array, output: Array) -> None:
    span, scale, width, top = law
    last, y, direction, count = state[0], state[1], state[2], int(state[3])
    for k in range(block.size):
        u = min(max(block[k] / span, 0.0), 1.0)
        if u != last:
            if (u - last) * direction < 0.0:
                direction = -direction
                if count == points.shape[0]:
                    for i in range(count - 2):  # one by one: the check of a whole slice's shape takes two seconds to compile
                        points[i, 0], points[i, 1] = points[i + 2, 0], points[i + 2, 1]
                    count -= 2
                points[count, 0], points[count, 1] = last, y
                count += 1
            goal_u, goal_y = (1.0, top) if direction > 0.0 else (0.0, 0.0)
            while count >= 2 and (u - points[count - 2, 0]) * direction >= 0.0:
                count -= 2
            if count >= 2:
                goal_u, goal_y = points[count - 2, 0], points[count - 2, 1]
            if count == 0 or u == goal_u:
                y = goal_y
            else:
                from_u, from_y = points[count - 1, 0], points[count - 1, 1]
                if direction > 0.0:
                    way, whole = _branch(up, u - from_u), _branch(up, goal_u - from_u)
                else:
                    way, whole = top - _branch(down, 1.0 - (from_u - u)), top - _branch(down, 1.0 - (from_u - goal_u))
                # A loop of rounding errors has no height: its branch is its end.
                y = from_y + (goal_y - from_y) * way / whole if whole > 0.0 else goal_y
            last = u
        output[k] = scale * (y + (width * (y - 0.5 * (_branch(up, u) + _branch(down, u))) if width != 0.0 else 0.0))
    state[0], state[1], state[2], state[3] = last, y, direction, count
