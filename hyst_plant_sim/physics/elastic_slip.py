# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""An ensemble of elastic-slip elements on an elastic slope: the rate-independent hysteresis of a piezo stack.

Element i follows the voltage with a slack of half-width r_i and adds w_i times its position; r_i fill (0, slip_range] evenly,
w_i follow a density that falls off exponentially. The memory of an element is its position minus the voltage; `width` scales
that (`hysteresis_width`), which leaves the mean curve, slope times voltage, as it is.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from hyst_plant_sim.physics.arrays import Array
from hyst_plant_sim.physics.signal_path import Part


class Slip(Part):
    """Polarization or free stroke for a voltage."""

    def __init__(
        self,
        elastic_slope: float,
        slip_slope: float,
        elements: int,
        slip_range: float,
        slip_decay: float,
        curvature: float = 0.0,
        width: float = 0.0,
    ) -> None:
        self._slack = slip_range * (np.arange(elements) + 0.5) / max(elements, 1)
        density = np.exp(-self._slack / slip_decay)
        weights = slip_slope * density / density.sum() if elements else density
        elastic = elastic_slope if width == 0 else elastic_slope - width * weights.sum()
        self._weights = weights if width == 0 else weights * (1.0 + width)
        self._law = np.array([elastic, curvature])
        # Of the first 0, 1, 2, … elements: sum of weights, and of weights times slacks.
        self._sums = np.stack([np.append(0.0, np.cumsum(values)) for values in (self._weights, self._weights * self._slack)])
        self._slip, self._state = np.zeros(elements), np.zeros(5)

    def settle(self, value: float) -> float:
        """Load the virgin elements from 0 straight to a constant input."""
        self._slip = np.clip(0.0, value - self._slack, value + self._slack)
        resting = float((self._weights * self._slip).sum())
        free = self._law[0] * value + resting
        self._state[:] = value, 0.0, 0.0, resting, free - self._law[1] * free * free
        return float(self._state[4])

    def process(self, block: Array) -> Array:
        """Move the elements along a block."""
        output = np.empty(block.size)
        _slip(block, self._slack, self._weights, self._sums, self._law, self._slip, self._state, output)
        return output


class PushPull(Part):
    """Two stacks that tilt a mirror: one driven by v, the other by bias - v; tilt is half the difference of their strokes.

    The second stack was taken from 0 V up to the bias before the drive left 0; the tilt counts from there.
    """

    def __init__(self, first: Slip, second: Slip, bias: float, offset: float) -> None:
        self._first, self._second, self._bias, self._offset = first, second, bias, offset

    def settle(self, value: float) -> float:
        """Bring the second stack to the bias, then both to a constant drive."""
        self._second.settle(self._bias)
        second = self._second.process(np.array([self._bias - value]))[0]
        return float(0.5 * (self._first.settle(value) - second) + self._offset)

    def process(self, block: Array) -> Array:
        """Drive the stacks against each other along a block."""
        return 0.5 * (self._first.process(block) - self._second.process(self._bias - block)) + self._offset


@njit(cache=True, error_model="numpy")
def _slip(block: Array, slack: Array, weights: Array, sums: Array, law: Array, slip: Array, state: Array, output: Array) -> None:
    """Move the elements. Those of little slack move first, so that the sum of the moving ones is known without a loop.

    state: last voltage, its direction (0: settled), number of elements that move with it, sum of the others, last output.
    slip: places of the others.
    """
    last, direction, moving, resting, value = state[0], state[1], int(state[2]), state[3], state[4]
    elastic, curvature, count = law[0], law[1], slack.size
    slope, held, goal = 0.0, 0.0, -np.inf  # of the elements that move: output per volt, rest; voltage at which another one moves
    for k in range(block.size):
        voltage = block[k]
        if voltage != last:
            if (voltage - last) * direction <= 0.0:  # it turns: all rest where they are
                for i in range(moving):
                    slip[i] = last - direction * slack[i]
                resting += sums[0, moving] * last - direction * sums[1, moving]
                direction, moving, goal = np.sign(voltage - last), 0, -np.inf
            if voltage * direction > goal:
                while moving < count and (voltage - slip[moving]) * direction > slack[moving]:
                    resting -= weights[moving] * slip[moving]
                    moving += 1
                if moving < count:
                    goal = slip[moving] * direction + slack[moving]
                else:
                    goal, resting = np.inf, 0.0
                slope, held = elastic + sums[0, moving], resting - direction * sums[1, moving]
            free = slope * voltage + held
            value = free - curvature * free * free
            last = voltage
        output[k] = value
    state[0], state[1], state[2], state[3], state[4] = last, direction, moving, resting, value
