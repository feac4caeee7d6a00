# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Effects, and the parts that switch one in from a given time on."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hyst_plant_sim.physics.arrays import Array
from hyst_plant_sim.physics.signal_path import Frame, Part

SETTLED = ("motion", "sensor", "adc", "transport")
"""Places whose settled value is the sample at t = 0; at earlier places it is the value before t = 0."""


@dataclass(frozen=True)
class Context:
    """Location of an effect."""

    frame: Frame  # Common data of the plant
    place: str  # One of `PLACES`
    axis: int | None  # Index of the axis; None: all axes
    start: float  # Time from which it acts, s

    @property
    def period(self) -> float:
        """Time (s) from one value to the next here."""
        return self.frame.period(self.place)

    @property
    def first(self) -> int:
        """Index of the first value of `process` at or after `start`."""
        return max(int(np.ceil(self.start / self.period - 1e-9)) - (self.place in SETTLED), 0)

    def times(self, count: int, length: int) -> Array:
        """Times of the next values of `process`."""
        return np.asarray((count + (self.place in SETTLED) + np.arange(length)) * self.period, dtype=np.float64)

    def stream(self, name: str) -> np.random.Generator:
        """Return the random numbers of this effect on this axis."""
        return self.frame.stream(name, self.axis)


@dataclass(frozen=True)
class Effect:
    """An effect by name."""

    # "insert" (an additional part at `place`), "mixing" (a part of all axes), "hysteresis" or "mechanics" (that part of the plant
    # is built with other parameters, which `make` returns), "delay" (as those, but of two parts: see `Delay`)
    kind: str
    place: str  # One of `PLACES`
    absent: Mapping[str, float]  # Parameters that set its strength, at the values where it is absent
    make: Callable[[Mapping[str, float], Context], Any]  # Constructor from parameters and location
    meaning: str  # One sentence
    units: Mapping[str, str]  # Units of the parameters
    others: Mapping[str, float] = field(default_factory=dict)  # The other parameters with their defaults


class PassThrough(Part):
    """Part that passes the signal through unchanged."""

    def settle(self, value: Any) -> Any:
        """Return the constant input."""
        return value

    def process(self, block: Array) -> Array:
        """Copy a block."""
        return block.copy()


class Switch(Part):
    """Parts that run alike, of which one at a time is the output."""

    def __init__(self, parts: Sequence[tuple[int, Part]]) -> None:
        self._first = [first for first, _ in parts]
        self._parts = [part for _, part in parts]
        self._count = 0

    def settle(self, value: Any) -> Any:
        """Settle all parts, and count samples from 0."""
        self._count = 0
        settled = [part.settle(np.array(value) if isinstance(value, np.ndarray) else value) for part in self._parts]
        return settled[max(i for i, first in enumerate(self._first) if first <= 0)]

    def process(self, block: Array) -> Array:
        """Run all parts over a block and output the active one at each sample."""
        output = self._parts[0].process(block.copy())
        length = block.shape[-1]
        for first, part in zip(self._first[1:], self._parts[1:], strict=True):
            found = part.process(block.copy())
            begin = min(max(first - self._count, 0), length)
            output[..., begin:] = found[..., begin:]
        self._count += length
        return output


class Pointwise(Part):
    """A function of the value alone."""

    def __init__(self, function: Callable[[Array], Array]) -> None:
        self._function = function

    def settle(self, value: float) -> float:
        """Apply the function to a constant input."""
        return float(self._function(np.array([value]))[0])

    def process(self, block: Array) -> Array:
        """Apply the function to a block."""
        return self._function(block)


class Timed(Part):
    """A function of values and of the times since the effect began, 0 before it."""

    def __init__(self, function: Callable[[Array, Array], Array], context: Context) -> None:
        self._function, self._context, self._count = function, context, 0

    def settle(self, value: float) -> float:
        """Apply the function to a constant input at the first sample's time."""
        self._count = 0
        return float(self._function(np.array([value]), np.array([max(0.0, -self._context.start)]))[0])

    def process(self, block: Array) -> Array:
        """Apply the function to a block, at times that go on from the block before."""
        times = self._context.times(self._count, len(block)) - self._context.start
        self._count += len(block)
        return self._function(block, np.maximum(times, 0.0))
