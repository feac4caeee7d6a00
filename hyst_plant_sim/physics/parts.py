# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Parts of every plant: exact linear dynamics, delay, clipping, white noise."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numba import njit

from hyst_plant_sim.physics import exact_discretization
from hyst_plant_sim.physics.arrays import Array
from hyst_plant_sim.physics.signal_path import Part

System = tuple[Array, Array, Array, float]


class Linear(Part):
    """Base of linear parts x' = a x + b u, y = c x + d u, stepped exactly."""

    def __init__(self, system: System, rows: Array) -> None:
        self._a, self._b, self._c, self._d = system
        self._rows, self._x, self._last = np.ascontiguousarray(rows), np.zeros(len(self._b)), np.zeros(1)

    def settle(self, value: float) -> float:
        """Rest at a constant input."""
        self._x, self._last = exact_discretization.rest(self._a, self._b, value), np.array([value])
        return float(self._c @ self._x + self._d * value)

    def process(self, block: Array) -> Array:
        """Step the exact state equation through a block."""
        output = np.empty(block.size)
        kernel = KERNELS[len(self._x)] if len(self._x) < len(KERNELS) else _of_any_order
        kernel(block, self._rows, self._x, self._last, output)
        return output


class Held(Linear):
    """Linear part whose input holds over a step.

    The output is the mean of y over the step, right for a part that takes it as held; or, with `late`, y at that time.
    """

    def __init__(self, system: System, step: float, late: float | None = None) -> None:
        a, b, c, d = system
        phi, gamma = exact_discretization.held_step(a, b, step)
        state, shift = (
            exact_discretization.mean_of_step(a, b, step) if late is None else exact_discretization.held_step(a, b, step - late)
        )
        none = np.zeros(len(b))
        super().__init__(system, np.vstack([np.column_stack([phi, none, gamma]), np.hstack([c @ state, 0.0, c @ shift + d])]))


class Straight(Linear):
    """Linear part whose input runs straight through a step; the output is y at its end."""

    def __init__(self, system: System, step: float) -> None:
        a, b, c, d = system
        rows = np.column_stack(exact_discretization.ramp_step(a, b, step))
        super().__init__(system, np.vstack([rows, c @ rows + np.append(np.zeros(len(b) + 1), d)]))


class Delay(Part):
    """A transport delay of whole steps; `rest` (s) is the remainder, which another part must apply.

    A held value that changes within a step cannot be described by one number. What follows the drive therefore runs ahead by the
    rest, and the mechanics, which are smooth, are read that much before the end of a step: exact, since a delay may be moved along
    a line that does not change with time.
    """

    def __init__(self, delay: float, step: float) -> None:
        steps = delay / step
        whole = int(np.floor(steps + 1e-9))
        self.rest = step * max(steps - whole, 0.0) if abs(steps - whole) > 1e-9 else 0.0
        self._past = np.zeros(whole)

    def settle(self, value: float) -> float:
        """Fill the delay line with a constant input."""
        self._past[:] = value
        return value

    def process(self, block: Array) -> Array:
        """Delay a block by the whole steps."""
        known = np.concatenate([self._past, block])
        self._past = known[len(block) :].copy()
        return known[: len(block)]


class LateReading(Part):
    """A transport delay of values at the ends of steps, between which they run straight."""

    def __init__(self, delay: float, step: float) -> None:
        self._whole = Delay(delay, step)
        self._share, self._last = self._whole.rest / step, 0.0

    def settle(self, value: float) -> float:
        """Fill the delay with a constant input."""
        self._last = self._whole.settle(value)
        return value

    def process(self, block: Array) -> Array:
        """Delay a block, with values between steps on straight lines."""
        late = self._whole.process(block)
        before = np.concatenate([[self._last], late])[: len(block)]
        self._last = float(late[-1]) if len(late) else self._last
        return (1.0 - self._share) * late + self._share * before


class Clip(Part):
    """Limits of a value."""

    def __init__(self, lower: float, upper: float) -> None:
        self._lower, self._upper = lower, upper

    def settle(self, value: float) -> float:
        """Limit a constant input."""
        return float(min(max(value, self._lower), self._upper))

    def process(self, block: Array) -> Array:
        """Limit every value of a block."""
        return np.clip(block, self._lower, self._upper)


class WhiteNoise(Part):
    """White noise of all axes; (A, M) in and out."""

    def __init__(self, rms: Annotated[Array, "A"], seed: int) -> None:
        self._rms, self._seed = rms, seed
        self._stream = np.random.default_rng(seed)

    def settle(self, values: Array) -> Array:
        """Restart the noise from its seed and add it to constant inputs."""
        self._stream = np.random.default_rng(self._seed)
        return self.process(values[:, None])[:, 0]

    def process(self, block: Array) -> Array:
        """Add noise to a block, the draws of all axes sample by sample."""
        return block + self._rms[:, None] * self._stream.standard_normal(block.shape[::-1]).T


class Mixing(Part):
    """Product of a matrix and the axes' values (A, M)."""

    def __init__(self, matrix: Annotated[Array, "A A"]) -> None:
        self._matrix = matrix

    def settle(self, values: Array) -> Array:
        """Mix constant inputs."""
        return self.process(values[:, None])[:, 0]

    def process(self, block: Array) -> Array:
        """Mix every sample of a block."""
        # Not a matrix product: its rounding may depend on the length of the block.
        return np.stack([sum(share * row for share, row in zip(shares, block, strict=True)) for shares in self._matrix])


class Chain(Part):
    """Parts in series."""

    def __init__(self, *parts: Part) -> None:
        self._parts = parts

    def settle(self, value: float) -> float:
        """Settle the parts one after the other, each at the output of the one before."""
        for part in self._parts:
            value = part.settle(value)
        return value

    def process(self, block: Array) -> Array:
        """Pass a block through all parts in order."""
        for part in self._parts:
            block = part.process(block)
        return block


class Sum(Part):
    """Parts in parallel."""

    def __init__(self, *parts: Part) -> None:
        self._parts = parts

    def settle(self, value: float) -> float:
        """Settle all parts at the same input and add their outputs."""
        return float(sum(part.settle(value) for part in self._parts))

    def process(self, block: Array) -> Array:
        """Add the outputs of all parts for a block."""
        first, *others = [part.process(block) for part in self._parts]
        return np.asarray(sum(others, start=first), dtype=np.float64)


# The states of the small systems stay in registers, which makes a step three times as fast as the one for any order.


@njit(cache=True, error_model="numpy")
def _of_any_order(block: Array, rows: Array, x: Array, last: Array, output: Array) -> None:
    order = x.size
    fresh = np.empty(order + 1)
    before = last[0]
    for k in range(block.size):
        now = block[k]
        for i in range(order + 1):
            value = rows[i, order] * before + rows[i, order + 1] * now
            for j in range(order):
                value += rows[i, j] * x[j]
            fresh[i] = value
        for i in range(order):
            x[i] = fresh[i]
        output[k] = fresh[order]
        before = now
    last[0] = before


@njit(cache=True, error_model="numpy")
def _of_first_order(block: Array, rows: Array, x: Array, last: Array, output: Array) -> None:
    (a, a_from, a_to), (y, y_from, y_to) = rows[0], rows[1]
    first, before = x[0], last[0]
    for k in range(block.size):
        now = block[k]
        output[k] = y_from * before + y_to * now + y * first
        first = a_from * before + a_to * now + a * first
        before = now
    x[0], last[0] = first, before


@njit(cache=True, error_model="numpy")
def _of_second_order(block: Array, rows: Array, x: Array, last: Array, output: Array) -> None:
    (a, b, a_from, a_to), (c, d, b_from, b_to), (y, z, y_from, y_to) = rows[0], rows[1], rows[2]
    first, second, before = x[0], x[1], last[0]
    for k in range(block.size):
        now = block[k]
        output[k] = y_from * before + y_to * now + (y * first + z * second)
        first, second = (
            a_from * before + a_to * now + (a * first + b * second),
            b_from * before + b_to * now + (c * first + d * second),
        )
        before = now
    x[0], x[1], last[0] = first, second, before


@njit(cache=True, error_model="numpy")
def _of_third_order(block: Array, rows: Array, x: Array, last: Array, output: Array) -> None:
    (a, b, c, a_from, a_to), (d, e, f, b_from, b_to) = rows[0], rows[1]
    (g, h, i, c_from, c_to), (y, z, w, y_from, y_to) = rows[2], rows[3]
    first, second, third, before = x[0], x[1], x[2], last[0]
    for k in range(block.size):
        now = block[k]
        output[k] = y_from * before + y_to * now + (y * first + z * second + w * third)
        first, second, third = (
            a_from * before + a_to * now + (a * first + b * second + c * third),
            b_from * before + b_to * now + (d * first + e * second + f * third),
            c_from * before + c_to * now + (g * first + h * second + i * third),
        )
        before = now
    x[0], x[1], x[2], last[0] = first, second, third, before


KERNELS = (_of_any_order, _of_first_order, _of_second_order, _of_third_order)
