# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Signal that begins and ends at rest and may be replaced by another one while it is being sent, without a jump."""

from __future__ import annotations

from collections import deque
from typing import Annotated, NamedTuple

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.records.excitation.waveforms import smooth_step

MAX_STRETCHES = 32  # Replacements that are remembered, for rows that are sent again
REST = 0.1  # Share of a signal's greatest step: one that begins or ends with less is at rest there


class _Stretch(NamedTuple):
    """Rows of one signal from a row on, which fades in over the one before."""

    first: int
    signal: Array
    fade: int


class ChangingSignal:
    """Rows of a signal by their number, also after it was replaced.

    A signal keeps its last row after its end, or starts again with `repeat`. From row n on, at which signal b takes the place of a,

        row_k = a_k + w(min(k - n + 1, fade) / fade) (b_k - a_k),   w(x) = x^3 (10 - 15 x + 6 x^2)

    whose slope and curvature do not jump, and which never leaves the range of the two. In this way a signal also begins at rest, over
    `ramp` rows, and ends at rest at its last row, over `end_ramp` rows; where it is at rest by itself it stays as it is.
    """

    def __init__(self, signal: Annotated[Array, "N A"], repeat: bool, ramp: int = 0, end_ramp: int = 0) -> None:
        self._repeat, self._ramp, self._end_ramp = repeat, ramp, end_ramp
        self._newest = signal
        self._stretches: deque[_Stretch] = deque(maxlen=MAX_STRETCHES)
        self.replace(signal, 0, 0)

    def begin_at(self, position: Array) -> None:
        """Begin at rest at a position (A,), from row 0 on."""
        signal, ramp = self._newest, self._ramp
        if not self._repeat and not _rests(signal[-2:], signal):
            ramp = min(ramp, len(signal) // 2)
        self._stretches.clear()
        if ramp and not _rests(np.concatenate([position[None], signal[:2]]), signal):
            self._stretches.append(_Stretch(0, position[None], 0))
        self.replace(signal, 0, ramp)

    def replace(self, signal: Annotated[Array, "N A"], first: int, fade: int) -> None:
        """Go on with another signal."""
        self._newest = signal
        while self._stretches and self._stretches[-1].first >= first > 0:
            self._stretches.pop()
        self._stretches.append(_Stretch(first, signal, fade))
        end = max(len(signal) - min(self._end_ramp, len(signal) // 2), first + 1)
        if self._end_ramp and not self._repeat and end < len(signal) and not _rests(signal[-2:], signal):
            self._stretches.append(_Stretch(end, signal[-1:], len(signal) - end))

    def rows(self, first: int, count: int) -> Array:
        """Rows of the signal."""
        return self._rows(len(self._stretches) - 1, first, count)

    def _rows(self, index: int, first: int, count: int) -> Array:
        """Rows by the stretches up to this one."""
        stretch = self._stretches[index]
        rows = self._of(stretch.signal, first, count)
        fading = min(stretch.first + stretch.fade - first, count) if index else 0
        if fading <= 0:
            return rows
        weight = smooth_step((np.arange(first, first + fading) - stretch.first + 1) / stretch.fade)[:, None]
        before = self._rows(index - 1, first, fading)
        return np.concatenate([before + weight * (rows[:fading] - before), rows[fading:]])

    def _of(self, signal: Array, first: int, count: int) -> Array:
        """Rows of one of the signals."""
        last = len(signal) - 1
        if self._repeat:
            first %= last + 1
        if first + count <= last + 1:
            return signal[first : first + count]
        numbers = np.arange(first, first + count)
        return signal[numbers % (last + 1) if self._repeat else np.minimum(numbers, last)]


def _rests(edge: Array, signal: Array) -> bool:
    """True when a signal moves at its edge by no more than a small share of its greatest step."""
    greatest = np.abs(np.diff(signal, axis=0)).max(initial=0.0)
    return bool(np.abs(np.diff(edge, axis=0)).max(initial=0.0) <= REST * greatest)
