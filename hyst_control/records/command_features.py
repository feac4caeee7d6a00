"""Features of a command, by which a model's error is predicted: level, rate, memory and lag, with scales that are fixed once.

A model of a piezo actuator errs with the level, with the direction and the distance since the last reversal (its memory is not the
actuator's), and with the rate. Features without the reversals do not predict hysteresis errors. All scales are numbers of their own, so
that what was learned on one command can be used on another.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]

PLAYS = (0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5)
"""Half widths of the play operators, as shares of the command's range; together they approximate the memory of any hysteresis."""
LAGS = (1.0, 4.0, 16.0)
"""Times of the command's lagged copies, as multiples of the time in which its fastest part crosses a 64th of its range."""
CREEPS = (0.3, 3.0)
"""Time constants of low-passed copies, as shares of the longest record."""
LEAST_REVERSAL = 0.01
"""Share of the range by which a command has to come back before its turning point counts as a reversal."""


@dataclass(frozen=True)
class CommandFeatures:
    """Features of the command of one axis.

    Parameters
    ----------
    center : float
        Middle of the range on which the scales were set, V.
    span : float
        Range, V.
    rate : float
        Largest rate, V/s.
    lag : float
        Time in which the fastest part crosses a 64th of the range, s.
    duration : float
        Length of the longest record, s.
    """

    center: float
    span: float
    rate: float
    lag: float
    duration: float

    @classmethod
    def of(cls, commands: Sequence[Array], sample_time: float) -> CommandFeatures:
        """Set the scales on commands.

        Parameters
        ----------
        commands : sequence of ndarray, shape (N,)
            Commands of one axis, V.
        sample_time : float
            Their sample time, s.

        Returns
        -------
        CommandFeatures
        """
        low, high = min(float(u.min()) for u in commands), max(float(u.max()) for u in commands)
        span = max(high - low, 1e-12)
        rate = max(float(np.quantile(np.abs(np.gradient(u, sample_time)), 0.99)) for u in commands)
        rate = max(rate, span / (max(map(len, commands)) * sample_time))
        return cls(0.5 * (low + high), span, rate, span / 64.0 / rate, max(map(len, commands)) * sample_time)

    @classmethod
    def from_document(cls, document: Mapping[str, Any]) -> CommandFeatures:
        """Read the scales from a model file.

        Parameters
        ----------
        document : mapping
            As `document` makes it.

        Returns
        -------
        CommandFeatures
        """
        return cls(**{name: float(document[name]) for name in cls.__dataclass_fields__})

    def document(self) -> dict[str, float]:
        """Convert the scales to JSON types."""
        return asdict(self)

    def rows(self, command: Array, sample_time: float) -> Array:
        """Compute the features of a command.

        Parameters
        ----------
        command : ndarray, shape (N,)
            Command, V.
        sample_time : float
            Its sample time, s.

        Returns
        -------
        ndarray, shape (N, F)
            Features, without unit.
        """
        u = (command - self.center) / self.span
        width = max(round(0.5 * self.lag / sample_time), 1)
        ahead, behind = _late(u[::-1], width)[::-1], _late(u, width)
        v = (ahead - behind) / (2.0 * width * sample_time) * self.span / self.rate
        distance = _since_reversal(u, LEAST_REVERSAL)
        size = np.abs(distance)
        found = [u, u**2, u**3, v, np.abs(v), u * v, u * np.abs(v), u**2 * v, distance * np.abs(v)]
        found += [distance, size, distance * size, u * distance, u * size, np.tanh(20.0 * distance)]
        found += [play(u, half) for half in PLAYS]
        found += [_late(u, max(round(lag * self.lag / sample_time), 1)) - u for lag in LAGS]
        found += [_lowpass(u, np.exp(-sample_time / (share * self.duration))) - u for share in CREEPS]
        return np.stack(found, axis=1)


def _late(u: Array, count: int) -> Array:
    count = min(count, len(u))
    return np.concatenate([np.full(count, u[0]), u[: len(u) - count]])


@njit(cache=True, error_model="numpy")
def play(values: Array, half: float) -> Array:
    """Play operator, which begins at its input.

    Parameters
    ----------
    values : ndarray, shape (N,)
        Input.
    half : float
        Half its width, in the input's unit.

    Returns
    -------
    ndarray, shape (N,)
        Output.
    """
    state, output = values[0], np.empty_like(values)
    for k in range(values.size):
        state = min(max(state, values[k] - half), values[k] + half)
        output[k] = state
    return output


@njit(cache=True, error_model="numpy")
def _lowpass(values: Array, keep: float) -> Array:
    state, output = values[0], np.empty_like(values)
    for k in range(values.size):
        state = keep * state + (1.0 - keep) * values[k]
        output[k] = state
    return output


@njit(cache=True, error_model="numpy")
def _since_reversal(values: Array, least: float) -> Array:
    """Signed distance from the last turning point; one counts once the signal has come back by `least`."""
    output = np.empty_like(values)
    turn, extreme, rising = values[0], values[0], True
    for k in range(values.size):
        value = values[k]
        if (value > extreme) == rising:
            if value != extreme:
                extreme = value
        if abs(value - extreme) > least and (value < extreme) == rising:
            turn, extreme, rising = extreme, value, not rising
        output[k] = value - turn
    return output
