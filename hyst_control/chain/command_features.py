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

    def rows(self, command: Array, sample_time: float, causal: bool = False) -> Array:
        """Compute the features of a command.

        Parameters
        ----------
        command : ndarray, shape (N,)
            Command, V.
        sample_time : float
            Its sample time, s.
        causal : bool
            Whether the rate is one of past samples alone, as a stage has it that runs along with the command; else it is centered.

        Returns
        -------
        ndarray, shape (N, F)
            Features, without unit.
        """
        running = FeatureFilter(self, sample_time)
        running.settle(float(command[0]))
        if causal:
            return running.process(command)
        u, width = (command - self.center) / self.span, running.width
        ahead, behind = _late(u[::-1], width)[::-1], _late(u, width)
        return running.process(command, (ahead - behind) / running.crossing)


class FeatureFilter:
    """Streaming features of the command of one axis: blocks may be cut anywhere.

    Parameters
    ----------
    features : CommandFeatures
        Scales.
    sample_time : float
        s.
    """

    def __init__(self, features: CommandFeatures, sample_time: float) -> None:
        self.features = features
        self.width = max(round(0.5 * features.lag / sample_time), 1)
        self.crossing = 2.0 * self.width * sample_time / features.span * features.rate
        """Change of the scaled command over twice `width` samples at the largest rate."""
        self.lags = [max(round(lag * features.lag / sample_time), 1) for lag in LAGS]
        self.keeps = [float(np.exp(-sample_time / (share * features.duration))) for share in CREEPS]
        self.settle(features.center)

    def settle(self, value: float) -> Array:
        """Begin at a command, V, that has rested.

        Parameters
        ----------
        value : float
            V.

        Returns
        -------
        ndarray, shape (F,)
            Features.
        """
        u = (value - self.features.center) / self.features.span
        self.past = np.full(max(*self.lags, 2 * self.width), u)
        self.reversal = np.array([u, u, 1.0])
        self.plays, self.lows = np.full(len(PLAYS), u), np.full(len(CREEPS), u)
        return np.asarray(self._columns(np.array([u]), np.zeros(1), np.tile(u, (len(LAGS), 1)))[0])

    def process(self, command: Array, rate: Array | None = None) -> Array:
        """Compute the features of the next samples.

        Parameters
        ----------
        command : ndarray, shape (N,)
            V.
        rate : ndarray, shape (N,), optional
            Rate as a share of the largest, from elsewhere than the past samples.

        Returns
        -------
        ndarray, shape (N, F)
            Features.
        """
        u = (command - self.features.center) / self.features.span
        known, count = np.concatenate([self.past, u]), len(self.past)
        late = [known[count - lag : len(known) - lag] for lag in self.lags]
        if rate is None:
            rate = (u - known[count - 2 * self.width : len(known) - 2 * self.width]) / self.crossing
        self.past = known[len(u) :].copy()
        return self._columns(u, rate, np.array(late))

    def _columns(self, u: Array, v: Array, late: Array) -> Array:
        distance = _since_reversal(u, LEAST_REVERSAL, self.reversal)
        size = np.abs(distance)
        found = [u, u**2, u**3, v, np.abs(v), u * v, u * np.abs(v), u**2 * v, distance * np.abs(v)]
        found += [distance, size, distance * size, u * distance, u * size, np.tanh(20.0 * distance)]
        found += [_play(u, half, self.plays[i : i + 1]) for i, half in enumerate(PLAYS)]
        found += list(late - u)
        found += [_lowpass(u, keep, self.lows[i : i + 1]) - u for i, keep in enumerate(self.keeps)]
        return np.stack(found, axis=1)


def _late(u: Array, count: int) -> Array:
    count = min(count, len(u))
    return np.concatenate([np.full(count, u[0]), u[: len(u) - count]])


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
    output: Array = _play(values, half, values[:1].copy())
    return output


@njit(cache=True, error_model="numpy")
def _play(values: Array, half: float, state: Array) -> Array:
    """state (1,): the output before, updated."""
    output = np.empty_like(values)
    for k in range(values.size):
        state[0] = min(max(state[0], values[k] - half), values[k] + half)
        output[k] = state[0]
    return output


@njit(cache=True, error_model="numpy")
def _lowpass(values: Array, keep: float, state: Array) -> Array:
    """state (1,): the output before, updated."""
    output = np.empty_like(values)
    for k in range(values.size):
        state[0] = keep * state[0] + (1.0 - keep) * values[k]
        output[k] = state[0]
    return output


@njit(cache=True, error_model="numpy")
def _since_reversal(values: Array, least: float, state: Array) -> Array:
    """Signed distance from the last turning point; one counts once the signal has come back by `least`.

    state (3,): last turning point, extreme since, whether the signal rises (1) or falls (0); updated.
    """
    output = np.empty_like(values)
    turn, extreme, rising = state[0], state[1], state[2] > 0.5
    for k in range(values.size):
        value = values[k]
        if (value > extreme) == rising:
            if value != extreme:
                extreme = value
        if abs(value - extreme) > least and (value < extreme) == rising:
            turn, extreme, rising = extreme, value, not rising
        output[k] = value - turn
    state[0], state[1], state[2] = turn, extreme, 1.0 if rising else 0.0
    return output


FEATURES = CommandFeatures(0.0, 1.0, 1.0, 1.0, 1.0).rows(np.zeros(1), 1.0).shape[1]
"""Number of features."""
