# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Features of a command, by which a model's error is predicted: level, rate, memory and lag, with scales that are fixed once.

A model of a piezo actuator errs with the level, with the direction and the distance since the last reversal (its memory is not the
actuator's), and with the rate. Features without the reversals do not predict hysteresis errors. All scales are numbers of their own, so
that what was learned on one command can be used on another.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Annotated, Any

import numpy as np
from numba import njit

from hyst_control.base.arrays import Array, Integers
from hyst_control.chain.c_code.c_code import Member, reals
from hyst_control.chain.c_code.texts import c_texts

PLAYS = (0.02, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5)
"""Half widths of the play operators, as shares of the command's range; together they approximate the memory of any hysteresis."""
LAGS = (1.0, 4.0, 16.0)
"""Times of the command's lagged copies, as multiples of the time in which its fastest part crosses a 64th of its range."""
CREEPS = (0.3, 3.0)  # Time constants of low-passed copies, as shares of the longest record
MIN_REVERSAL = 0.01  # Share of the range by which a command has to come back before its turning point counts as a reversal
LONGEST, BLOCK = 2**20, 2**18
"""Samples of a command from which quantiles of its rate are taken; samples whose features are computed at a time."""


@dataclass(frozen=True)
class CommandFeatures:
    """Features of the command of one axis."""

    center: float  # Middle of the range on which the scales were set, V
    span: float  # Range, V
    rate: float  # Largest rate, V/s
    lag: float  # Time in which the fastest part crosses a 64th of the range, s
    duration: float  # Length of the longest record, s

    @classmethod
    def of(cls, commands: Sequence[Array], sample_time: float) -> CommandFeatures:
        """Set the scales on commands."""
        low, high = min(float(u.min()) for u in commands), max(float(u.max()) for u in commands)
        span = max(high - low, 1e-12)
        rate = max(rate_quantile(u, sample_time, 0.99) for u in commands)
        rate = max(rate, span / (max(map(len, commands)) * sample_time))
        return cls(0.5 * (low + high), span, rate, span / 64.0 / rate, max(map(len, commands)) * sample_time)

    @classmethod
    def from_document(cls, document: Mapping[str, Any]) -> CommandFeatures:
        """Read the scales from a model file."""
        return cls(**{name: float(document[name]) for name in cls.__dataclass_fields__})

    def document(self) -> dict[str, float]:
        """Convert the scales to JSON types."""
        return asdict(self)

    def rows(self, command: Annotated[Array, "N"], sample_time: float, causal: bool = False) -> Annotated[Array, "N F"]:
        """Compute the features of a command."""
        # causal: whether the rate is one of past samples alone, as a stage has it that runs along with the command; else it is
        # centered
        if not causal:
            return np.concatenate([rows for _, rows in self.blocks(command, sample_time)])
        running = FeatureFilter(self, sample_time)
        running.settle(float(command[0]))
        return running.process(command)

    def blocks(self, command: Annotated[Array, "N"], sample_time: float) -> Iterator[tuple[slice, Array]]:
        """Compute the features of a command of any length block by block: those of `rows`, the rate being centered."""
        running = FeatureFilter(self, sample_time)
        running.settle(float(command[0]))
        for begin in range(0, len(command), BLOCK):
            part = slice(begin, min(begin + BLOCK, len(command)))
            places = np.arange(part.start, part.stop)
            ahead = (command[np.minimum(places + running.width, len(command) - 1)] - self.center) / self.span
            behind = (command[np.maximum(places - running.width, 0)] - self.center) / self.span
            yield part, running.process(command[part], (ahead - behind) / running.crossing)


def rate_quantile(command: Annotated[Array, "N"], sample_time: float, share: float) -> float:
    """Quantile of the size of a command's rate."""
    if len(command) <= LONGEST:
        return float(np.quantile(np.abs(np.gradient(command, sample_time)), share))
    rows = np.linspace(1, len(command) - 2, LONGEST).astype(np.int64)
    return float(np.quantile(np.abs(command[rows + 1] - command[rows - 1]), share)) / (2.0 * sample_time)


POWERS, FIRST_PLAY = 3, 15  # Features that are powers of the level, and the place of the first play operator
FEATURES = FIRST_PLAY + len(PLAYS) + len(LAGS) + len(CREEPS)  # Number of features
SIZES = {"PLAY_COUNT": len(PLAYS), "LAG_COUNT": len(LAGS), "CREEP_COUNT": len(CREEPS), "FIRST_PLAY": FIRST_PLAY}
FEATURES_IN_C = c_texts(__file__, **SIZES, MIN_REVERSAL=MIN_REVERSAL)["FEATURES_IN_C"]

Constants = tuple[Integers, Array, Array]  # Lags, half widths of the play operators, and what the low-passes keep in a tick
Past = tuple[Annotated[Array, "L"], Integers]  # Ring of past commands, and the place of the newest
Memory = tuple[Annotated[Array, "3"], Array, Array]  # Turning point, play operators, low-passes


@njit(cache=True, error_model="numpy")
def features_of_tick(
    ring: Annotated[Array, "L"], now: int, rate: float, constants: Constants, memory: Memory, features: Annotated[Array, "F"]
) -> None:
    """Advance the memories by one tick and compute its features."""
    (lags, half_widths, keeps), (turning, plays, slow) = constants, memory
    length = ring.size
    u = ring[now % length]
    turn, extreme, rising = turning[0], turning[1], turning[2]
    if u > extreme if rising > 0.0 else u < extreme:
        extreme = u
    if abs(u - extreme) > MIN_REVERSAL:  # it has come back
        turn, extreme, rising = extreme, u, 1.0 - rising
    turning[0], turning[1], turning[2] = turn, extreme, rising
    distance, speed = u - turn, abs(rate)
    size = abs(distance)
    features[0], features[1], features[2] = u, u * u, u * u * u
    features[3], features[4], features[5], features[6] = rate, speed, u * rate, u * speed
    features[7], features[8] = u * u * rate, distance * speed
    features[9], features[10], features[11] = distance, size, distance * size
    features[12], features[13], features[14] = u * distance, u * size, math.tanh(20.0 * distance)
    at = FIRST_PLAY
    for k in range(half_widths.size):
        low, high, state = u - half_widths[k], u + half_widths[k], plays[k]
        state = low if state < low else state
        plays[k] = high if state > high else state
        features[at + k] = plays[k]
    at += half_widths.size
    for k in range(lags.size):
        features[at + k] = ring[(now - lags[k]) % length] - u
    at += lags.size
    for k in range(keeps.size):
        slow[k] = keeps[k] * slow[k] + (1.0 - keeps[k]) * u
        features[at + k] = slow[k] - u


def feature_memory(axes: int, length: int) -> dict[str, Member]:
    """State of the features in C."""
    shapes = {"ring": (length, "scaled commands"), "plays": (len(PLAYS), "play operators"), "slow": (len(CREEPS), "low-passes")}
    found = {name: reals(np.zeros((axes, count)), text, wide=True) for name, (count, text) in shapes.items()}
    return {**found, "turning": reals(np.zeros((axes, 3)), "turning point, farthest value since, 1 while rising", wide=True)}


@njit(cache=True, error_model="numpy")
def feature_rows(
    command: Annotated[Array, "N"], rate: Annotated[Array, "N"], crossing: float, constants: Constants, past: Past, memory: Memory
) -> Array:
    """Features (N, F) of successive ticks of one axis."""
    (ticks, half_widths, keeps), (ring, position) = constants, past
    length = ring.size
    rows = np.empty((command.size, FEATURES))
    for row in range(command.size):
        position[0] = position[0] + 1 if position[0] + 1 < length else 0
        now = position[0] + length
        ring[position[0]] = command[row]
        speed = rate[row] if rate.size else (command[row] - ring[(now - ticks[0]) % length]) / crossing
        features_of_tick(ring, now, speed, (ticks[1:], half_widths, keeps), memory, rows[row])
    return rows


class FeatureFilter:
    """Streaming features of the command of one axis: blocks may be cut anywhere."""

    def __init__(self, features: CommandFeatures, sample_time: float) -> None:
        self.features = features
        self.width = max(round(0.5 * features.lag / sample_time), 1)
        self.crossing = 2.0 * self.width * sample_time / features.span * features.rate
        """Change of the scaled command over twice `width` samples at the largest rate."""
        self.lags = np.array([max(round(lag * features.lag / sample_time), 1) for lag in LAGS], dtype=np.int64)
        self.keeps = np.array([np.exp(-sample_time / (share * features.duration)) for share in CREEPS])
        self.ticks = np.concatenate([[2 * self.width], self.lags]).astype(np.int64)
        self.settle(features.center)

    def settle(self, value: float) -> Annotated[Array, "F"]:
        """Begin at a command, V, that has rested."""
        u = (value - self.features.center) / self.features.span
        self.ring, self.position = np.full(int(self.ticks.max()) + 1, u), np.zeros(1, dtype=np.int64)
        self.turning = np.array([u, u, 1.0])
        self.plays, self.slow = np.full(len(PLAYS), u), np.full(len(CREEPS), u)
        return np.asarray(at_rest(np.array([u]))[0])

    def process(self, command: Annotated[Array, "N"], rate: Array | None = None) -> Annotated[Array, "N F"]:
        """Compute the features of the next samples."""
        u = (command - self.features.center) / self.features.span
        given = np.zeros(0) if rate is None else rate
        constants, memory = (self.ticks, np.array(PLAYS), self.keeps), (self.turning, self.plays, self.slow)
        return np.asarray(feature_rows(u, given, self.crossing, constants, (self.ring, self.position), memory))


def at_rest(u: Annotated[Array, "A"]) -> Array:
    """Features (A, F) of scaled commands (A,) that have rested."""
    found = np.zeros((len(u), FEATURES))
    found[:, 0], found[:, 1], found[:, 2] = u, u * u, u * u * u
    found[:, FIRST_PLAY : FIRST_PLAY + len(PLAYS)] = u[:, None]
    return found


@njit(cache=True, error_model="numpy")
def play(values: Annotated[Array, "N"], half: float) -> Annotated[Array, "N"]:
    """Play operator, which begins at its input."""
    state, output = values[0], np.empty_like(values)
    for k in range(values.size):
        state = min(max(state, values[k] - half), values[k] + half)
        output[k] = state
    return output
