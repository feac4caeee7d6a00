# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Signal path of a plant from the command to the measurement, place by place, and the plant that runs it.

A part is one axis' element at one place: `settle(value)` brings it to rest at a constant input and returns its first output,
`process(block (M,))` returns as many outputs and carries its state on, so that cutting a signal changes no bit. A part that
mixes axes is entered for axis None and gets (A, M).

Meaning of a value between the samples: from the drive up to the mechanics for the whole internal step, held there or the
mean over it, which the next part takes as held; from the mechanics on for the end of the step, up to which the next part takes
it as running straight. Both are of second order in the step, also where a command jumps.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Protocol
from zlib import crc32

import numpy as np

from hyst_plant_sim.physics.arrays import Array

PLACES = ("dac", "drive", "amplifier", "hysteresis", "piezo", "mechanics", "motion", "sensor", "adc", "transport")
"""In signal order. dac, adc and transport work on samples, the others on the internal steps in between."""

SAMPLED = ("dac", "adc", "transport")
BLOCK = 1024
"""Most samples taken through the line at a time: bounds the memory, and changes no bit."""


class PlantError(ValueError):
    """Unusable plant description: one line with field and remedy."""


class Part(Protocol):
    """An element of the line; see the module."""

    def settle(self, value: Any) -> Any:
        """Come to rest at a constant input."""
        ...

    def process(self, block: Annotated[Array, "M"]) -> Array:
        """Compute the output for the next block of the input."""
        ...


@dataclass(frozen=True)
class Frame:
    """Common data of all parts of a plant."""

    name: str  # Name of the plant
    axes: tuple[str, ...]  # Names of the axes
    units: dict[str, str]  # Units by signal
    sample_time: float  # Sample time, s
    substeps: int  # Internal steps per sample
    rating: tuple[float, float]  # Range of the command, V
    slew_limit: float  # Slew rate of the amplifier, V/s
    stroke: tuple[float, float]  # Range to which the effects refer (measurement unit)
    seed: int  # Seed of all random numbers

    @property
    def step(self) -> float:
        """The internal step, s."""
        return self.sample_time / self.substeps

    def period(self, place: str) -> float:
        """Time from one value to the next at a place."""
        return self.sample_time if place in SAMPLED else self.step

    def stream(self, name: str, axis: int | None) -> np.random.Generator:
        """Return the random numbers of one effect on one axis, independent of all others."""
        return np.random.default_rng([self.seed, crc32(name.encode()), 0 if axis is None else axis + 1])


Entry = tuple["int | None", Part]
Line = dict[str, list[Entry]]


class PlantParameters(ABC):
    """Physical parameters of a plant, which construct its parts."""

    @abstractmethod
    def parts(self, axis: int, frame: Frame, hysteresis: Mapping[str, float], moving: Mapping[str, Any]) -> dict[str, list[Part]]:
        """Construct the parts of an axis by place."""


class Plant:
    """A running reference simulation: `reset` it, then `step` it with commands in V."""

    def __init__(self, frame: Frame, line: Line) -> None:
        self.frame, self._line = frame, line
        self.name, self.axes, self.units, self.sample_time = frame.name, frame.axes, frame.units, frame.sample_time
        self.rating, self.slew_limit = frame.rating, frame.slew_limit
        places = list(PLACES)
        self._before = line.get("dac", [])
        self._between = [entry for place in places[1 : places.index("adc")] for entry in line.get(place, [])]
        self._after = [entry for place in places[places.index("adc") :] for entry in line.get(place, [])]
        self.reset(np.zeros(len(self.axes)))

    def reset(self, command: Annotated[Array, "A"]) -> Annotated[Array, "A"]:
        """Settle at a command that is reached from 0 V on the initial loading curve."""
        values = np.array(np.broadcast_to(np.asarray(command, dtype=float), len(self.axes)))
        for axis, part in (*self._before, *self._between, *self._after):
            if axis is None:
                values = part.settle(values)
            else:
                values[axis] = part.settle(float(values[axis]))
        return values

    def step(self, commands: Annotated[Array, "N A"]) -> Annotated[Array, "N A"]:
        """Apply commands, each held for one sample."""
        commands = np.asarray(commands, dtype=float)
        output = np.empty((len(commands), len(self.axes)))
        for start in range(0, len(commands), BLOCK):
            piece = slice(start, start + BLOCK)
            block = _through(self._before, np.array(commands[piece].T, order="C"))
            block = _through(self._between, np.repeat(block, self.frame.substeps, axis=1))
            block = np.ascontiguousarray(block[:, self.frame.substeps - 1 :: self.frame.substeps])
            output[piece] = _through(self._after, block).T
        return output


def _through(entries: Sequence[Entry], block: Array) -> Array:
    for axis, part in entries:
        if axis is None:
            block = part.process(block)
        else:
            block[axis] = part.process(block[axis])
    return block
