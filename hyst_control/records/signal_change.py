"""Signal that may be replaced by another one while it is being sent, without a jump."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

MOST_STRETCHES = 32
"""Replacements that are remembered, for rows that are sent again."""


class _Stretch(NamedTuple):
    """Rows of one signal from a row on, with the distance to the one before, which fades away."""

    first: int
    signal: Array
    distance: Array
    fade: int


class ChangingSignal:
    """Rows of a signal by their number, also after it was replaced.

    A signal keeps its last row after its end, or starts again with `repeat`. From row n on, at which signal b takes the place of a,

        row_k = b_k + (row_{n-1} - b_{n-1}) (1 + cos(pi min(k - n + 1, fade) / fade)) / 2

    so that no step is greater than that of b itself plus pi / (2 fade) of the distance between the two.

    Parameters
    ----------
    signal : ndarray, shape (N, A)
        The first signal.
    repeat : bool
        Start again at the end.
    """

    def __init__(self, signal: Array, repeat: bool) -> None:
        self._repeat = repeat
        self._stretches: deque[_Stretch] = deque([_Stretch(0, signal, np.zeros(signal.shape[1]), 1)], MOST_STRETCHES)

    @property
    def newest(self) -> Array:
        """The signal (N, A) that was given last."""
        return self._stretches[-1].signal

    def replace(self, signal: Array, first: int, fade: int) -> None:
        """Go on with another signal.

        Parameters
        ----------
        signal : ndarray, shape (N, A)
            The signal.
        first : int
            Row from which on it is used; the rows before it stay.
        fade : int
            Rows over which the distance between the two fades away, 1 at least.
        """
        distance = self.rows(first - 1, 1)[0] - self._of(signal, first - 1, 1)[0] if first > 0 else np.zeros(signal.shape[1])
        while self._stretches and self._stretches[-1].first >= first:
            self._stretches.pop()
        self._stretches.append(_Stretch(first, signal, distance, fade))

    def rows(self, first: int, count: int) -> Array:
        """Rows of the signal.

        Parameters
        ----------
        first, count : int
            Number of the first row, and how many.

        Returns
        -------
        ndarray, shape (count, A)
            The rows.
        """
        newest = self._stretches[-1]
        if first >= newest.first + newest.fade or len(self._stretches) == 1:
            return self._of(newest.signal, first, count)
        parts, end = [], first + count
        for stretch in reversed(self._stretches):
            begin = max(first, stretch.first) if stretch is not self._stretches[0] else first
            if begin < end:
                rows = self._of(stretch.signal, begin, end - begin)
                through = np.minimum(np.arange(begin, end) - stretch.first + 1, stretch.fade) / stretch.fade
                parts.append(rows + 0.5 * (1.0 + np.cos(np.pi * through))[:, None] * stretch.distance)
                end = begin
        return np.concatenate(parts[::-1])

    def _of(self, signal: Array, first: int, count: int) -> Array:
        """Rows of one of the signals."""
        last = len(signal) - 1
        if self._repeat:
            first %= last + 1
        if first + count <= last + 1:
            return signal[first : first + count]
        numbers = np.arange(first, first + count)
        return signal[numbers % (last + 1) if self._repeat else np.minimum(numbers, last)]
