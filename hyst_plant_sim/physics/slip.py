"""An ensemble of elastic-slip elements on an elastic slope: the rate-independent hysteresis of a piezo stack.

Element i follows the voltage with a slack of half-width r_i and adds w_i times its position; r_i fill (0, slip_range] evenly,
w_i follow a density that falls off exponentially. The memory of an element is its position minus the voltage; `width` scales
that (`hysteresis_width`), which leaves the mean curve, slope times voltage, as it is.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


class Slip:
    """Polarisation or free stroke for a voltage; slopes in output unit / V, range and decay in V, curvature in 1 / output unit."""

    def __init__(self, elastic_slope: float, slip_slope: float, elements: int, slip_range: float, slip_decay: float,
                 curvature: float = 0.0, width: float = 0.0) -> None:
        self._slack = slip_range * (np.arange(elements) + 0.5) / max(elements, 1)
        density = np.exp(-self._slack / slip_decay)
        weights = slip_slope * density / density.sum() if elements else density
        elastic = elastic_slope if width == 0 else elastic_slope - width * weights.sum()
        self._weights = weights if width == 0 else weights * (1.0 + width)
        self._law = np.array([elastic, curvature])
        # Filled up with elements of no weight: the kernel takes four at a time.
        self._weights, self._slack = (np.append(values, np.zeros(-elements % 4)) for values in (self._weights, self._slack))
        self._slip = np.zeros(len(self._slack))

    def settle(self, value: float) -> float:
        self._slip = np.clip(0.0, value - self._slack, value + self._slack)
        return float(self.process(np.array([value]))[0])

    def process(self, block: Array) -> Array:
        output = np.empty(block.size)
        _slip(block, self._slack, self._weights, self._law, self._slip, output)
        return output


class PushPull:
    """Two stacks that tilt a mirror: one driven by v, the other by bias - v; tilt is half the difference of their strokes.

    The second stack was taken from 0 V up to the bias before the drive left 0; the tilt counts from there.
    """

    def __init__(self, first: Slip, second: Slip, bias: float, offset: float) -> None:
        self._first, self._second, self._bias, self._offset = first, second, bias, offset

    def settle(self, value: float) -> float:
        self._second.settle(self._bias)
        second = self._second.process(np.array([self._bias - value]))[0]
        return float(0.5 * (self._first.settle(value) - second) + self._offset)

    def process(self, block: Array) -> Array:
        return 0.5 * (self._first.process(block) - self._second.process(self._bias - block)) + self._offset


@njit(cache=True, error_model="numpy")
def _slip(block, slack, weights, law, slip, output):
    last, value = np.nan, 0.0
    for k in range(block.size):
        voltage = block[k]
        if voltage != last:
            for i in range(slack.size):  # apart from the sums, so that it is done for several elements at once
                lower, upper, place = voltage - slack[i], voltage + slack[i], slip[i]
                place = lower if place < lower else place
                slip[i] = upper if place > upper else place
            # Four sums side by side, because one would wait for each addition.
            a, b, c, d = law[0] * voltage, 0.0, 0.0, 0.0
            for i in range(0, slack.size, 4):
                a += weights[i] * slip[i]
                b += weights[i + 1] * slip[i + 1]
                c += weights[i + 2] * slip[i + 2]
                d += weights[i + 3] * slip[i + 3]
            value = (a + b) + (c + d)
            value -= law[1] * value * value
            last = voltage
        output[k] = value
