"""Parts that every plant is made of: exact linear dynamics, delay, clipping, white noise."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from hyst_plant_sim.physics import exact

Array = NDArray[np.float64]
System = tuple[Array, Array, Array, float]


class Linear:
    """x' = a x + b u, y = c x + d u, stepped exactly for an input that holds over a step or runs straight through it.

    The output is that at the end of a step, or in its middle (held input only): right for a part that takes it as held.
    """

    def __init__(self, system: System, step: float, held: bool = False, middle: bool = False) -> None:
        self._a, self._b, self._c, self._d = system
        if held:
            self._phi, self._to = exact.held_step(self._a, self._b, step)
            self._from = np.zeros_like(self._to)
        else:
            self._phi, self._from, self._to = exact.ramp_step(self._a, self._b, step)
        if middle:  # read from the state at the end: back by half a step, which the input is known for
            back, shift = exact.held_step(self._a, self._b, -0.5 * step)
            self._c, self._d = self._c @ back, float(self._d + self._c @ shift)
        self._x, self._last = np.zeros(len(self._b)), np.zeros(1)

    def settle(self, value: float) -> float:
        self._x, self._last = exact.rest(self._a, self._b, value), np.array([value])
        return float(self._c @ self._x + self._d * value)

    def process(self, block: Array) -> Array:
        output = np.empty(block.size)
        _linear(block, self._phi, self._from, self._to, self._c, self._d, self._x, self._last, output)
        return output


class Delay:
    """A transport delay (s); a fraction of a step is shared between two neighbouring values."""

    def __init__(self, delay: float, step: float) -> None:
        steps = delay / step
        self._whole = int(np.floor(steps + 1e-9))
        self._share = max(steps - self._whole, 0.0) if abs(steps - self._whole) > 1e-9 else 0.0
        self._past = np.zeros(self._whole + 1)

    def settle(self, value: float) -> float:
        self._past[:] = value
        return value

    def process(self, block: Array) -> Array:
        known = np.concatenate([self._past, block])
        self._past = known[len(known) - len(self._past):].copy()
        late = known[1:len(block) + 1]
        return (1.0 - self._share) * late + self._share * known[:len(block)] if self._share else late.copy()


class Clip:
    """The value within lower … upper."""

    def __init__(self, lower: float, upper: float) -> None:
        self._lower, self._upper = lower, upper

    def settle(self, value: float) -> float:
        return float(min(max(value, self._lower), self._upper))

    def process(self, block: Array) -> Array:
        return np.clip(block, self._lower, self._upper)


class WhiteNoise:
    """White noise of all axes, rms (A,); (A, M) in and out."""

    def __init__(self, rms: Array, seed: int) -> None:
        self._rms, self._seed = rms, seed
        self._stream = np.random.default_rng(seed)

    def settle(self, values: Array) -> Array:
        self._stream = np.random.default_rng(self._seed)
        return self.process(values[:, None])[:, 0]

    def process(self, block: Array) -> Array:
        return block + self._rms[:, None] * self._stream.standard_normal(block.shape[::-1]).T


class Mixing:
    """(A, M) times a matrix (A, A)."""

    def __init__(self, matrix: Array) -> None:
        self._matrix = matrix

    def settle(self, values: Array) -> Array:
        return self.process(values[:, None])[:, 0]

    def process(self, block: Array) -> Array:
        # Not a matrix product: its rounding may depend on the length of the block.
        return np.stack([sum(share * row for share, row in zip(shares, block, strict=True)) for shares in self._matrix])


class Chain:
    """Parts in a row, as one."""

    def __init__(self, *parts) -> None:
        self._parts = parts

    def settle(self, value: float) -> float:
        for part in self._parts:
            value = part.settle(value)
        return value

    def process(self, block: Array) -> Array:
        for part in self._parts:
            block = part.process(block)
        return block


@njit(cache=True, error_model="numpy")
def _linear(block, phi, ramp_from, ramp_to, read, direct, x, last, output):
    order = x.size
    fresh = np.empty(order)
    before = last[0]
    for k in range(block.size):
        now = block[k]
        for i in range(order):
            value = ramp_from[i] * before + ramp_to[i] * now
            for j in range(order):
                value += phi[i, j] * x[j]
            fresh[i] = value
        value = direct * now
        for i in range(order):
            x[i] = fresh[i]
            value += read[i] * x[i]
        output[k] = value
        before = now
    last[0] = before
