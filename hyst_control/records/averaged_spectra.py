# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Averaged spectra of a record, and what they tell of every axis: explained power, phase lag and frequency response."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array, Complex, Mask

SEGMENTS = 32
"""Parts of a record over which spectra are averaged, at least: few averages show a coherence where there is none."""

LONGEST_SEGMENT = 2**14

SHORTEST_SEGMENT = 8

SURE, EXCITED = 0.8, 1e-3
"""Coherence, and power relative to the strongest frequency, from which a response is compared with another record's."""

FEWEST_LINES = 3  # Frequencies that two records must share

INDEPENDENT = 0.1
"""Smallest eigenvalue of the commands' coherence matrix from which the responses to each of them are told apart."""


@dataclass(frozen=True)
class Spectra:
    """Averaged spectra: auto (F, A, A) of the commands, cross (F, A, A) [command, measurement], power (F, A) of the measurements."""

    auto: Complex
    cross: Complex
    power: Array

    @classmethod
    def of(
        cls, command: Annotated[Array, "N A"], measurement: Annotated[Array, "N A"], length: int, periodic: bool = False
    ) -> Spectra:
        """Spectra averaged over segments of `length` samples that overlap by half, after the mean of the whole record is removed."""
        command, measurement = command - command.mean(axis=0), measurement - measurement.mean(axis=0)
        window = np.ones((length, 1)) if periodic else np.hanning(length)[:, None]
        step = length if periodic else max(length // 2, 1)
        lines, axes = length // 2 + 1, command.shape[1]
        auto, cross = np.zeros((lines, axes, axes), complex), np.zeros((lines, axes, axes), complex)
        power = np.zeros((lines, axes))
        for begin in range(0, len(command) - length + 1, step):
            part = slice(begin, begin + length)
            u, y = np.fft.rfft(command[part] * window, axis=0), np.fft.rfft(measurement[part] * window, axis=0)
            auto += u[:, :, None].conj() * u[:, None, :]
            cross += u[:, :, None].conj() * y[:, None, :]
            power += np.abs(y) ** 2
        return cls(auto, cross, power)

    @property
    def explained(self) -> Array:
        """Share (A,) of each measurement's power that a linear system of all commands could make."""
        axes = self.auto.shape[1]
        size = np.trace(self.auto, axis1=1, axis2=2).real
        regular = self.auto + (1e-9 * size + 1e-300)[:, None, None] * np.eye(axes)
        response = np.linalg.solve(regular, self.cross)
        made = np.einsum("fab,fab->b", response.conj(), self.cross).real
        return np.asarray(made / np.maximum(self.power.sum(axis=0), 1e-300), dtype=np.float64)

    @cached_property
    def independent(self) -> Mask:
        """Frequencies (F,) at which no command is a sum of others."""
        own = np.sqrt(np.maximum(np.einsum("faa->fa", self.auto).real, 1e-300))
        normal = self.auto / (own[:, :, None] * own[:, None, :])
        return np.asarray(np.linalg.eigvalsh(normal)[:, 0] > INDEPENDENT)

    @cached_property
    def transfer(self) -> Complex:
        """Responses (F, A, A) [command, measurement] to independent commands; 0 where they are not."""
        found = np.zeros_like(self.cross)
        apart = self.independent
        found[apart] = np.linalg.solve(self.auto[apart], self.cross[apart])
        return found

    @property
    def coherence(self) -> Array:
        """Share (F, A) of each measurement's power that the commands together make; 0 where they are not independent."""
        made = np.einsum("fab,fab->fb", self.transfer.conj(), self.cross).real
        return np.asarray(np.clip(made / np.maximum(self.power, 1e-300), 0.0, 1.0), dtype=np.float64)

    def _path(self, index: int) -> tuple[Complex, Array]:
        """Cross spectrum (F,) of command and measurement of an axis, without what other independent commands make, and its share."""
        own, power = self.auto[:, index, index].real, self.power[:, index]
        cross = self.cross[:, index, index].copy()
        made = np.abs(cross) ** 2 / np.maximum(own * power, 1e-300)
        if self.auto.shape[1] > 1 and (apart := self.independent).any():
            response = self.transfer[apart][:, :, index]
            cross[apart] = response[:, index] * own[apart]
            explained = np.sum(response.conj() * self.cross[apart][:, :, index], axis=1).real / np.maximum(power[apart], 1e-300)
            direct = np.abs(cross[apart]) ** 2 / np.maximum(own[apart] * power[apart], 1e-300)
            made[apart] = np.where(direct > INDEPENDENT, explained, 0.0)
        return cross, np.asarray(made, dtype=np.float64)

    def response(self, index: int) -> tuple[Complex, Mask]:
        """Frequency response (F,) of axis `index` to its command, and a mask (F,) of the frequencies at which it is known."""
        return self._responses[index]

    @cached_property
    def _responses(self) -> list[tuple[Complex, Mask]]:
        found = []
        for index in range(self.auto.shape[1]):
            own = self.auto[:, index, index].real
            cross, made = self._path(index)
            sure = made > SURE
            for power in (own, self.power[:, index]):
                sure &= power > EXCITED * power[1:].max(initial=0.0)
            found.append((cross / np.maximum(own, 1e-300), sure))
        return found


def segment_length(count: int) -> int:
    """Samples per segment of a record of `count` samples."""
    return min(max(count // SEGMENTS, SHORTEST_SEGMENT), LONGEST_SEGMENT)
