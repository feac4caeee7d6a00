# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Stages with different values for each record: the zero of a session, and a model's error, carried over or learned.

    measurement = sensor effects( model with its effects(command) + error(t) ) + zero(t)

The sensor's zero and the piezo's remanence differ between sessions, and are fitted together with every hypothesis. The error is known
sample by sample from a baseline record of the same command, or predicted with weights that are free within their posterior.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import sha256
from typing import Annotated, Any, ClassVar

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.signals import convolved
from hyst_control.chain.linear.linear_stages import Delay
from hyst_control.chain.parameter import AllAxes, Scattering, all_axes, count
from hyst_control.chain.stage import Filter, Sampling, Stage
from hyst_control.effects.placement import insert
from hyst_control.effects.time_dependent import TimedStage
from hyst_control.records.session_zero import SHAPES


@dataclass(frozen=True)
class SessionZero(TimedStage):
    """Zero, drift and curvature of each record: adds Σ (known + scale[axis][k] · shares)[record][axis][k] P_k(2 t / duration - 1).

    P_k is the Legendre polynomial of degree k = 0, 1, 2 (zero, drift, curvature), t the time since the record's start.
    What a unit's sessions usually have is known, and no part of a gap: a sensor's zero is arbitrary.
    """

    FIELD: ClassVar[str] = "shares"
    name: ClassVar[str] = "session_zero"
    place: ClassVar[str] = "adc"
    shares: AllAxes = all_axes("", "of the scale, by record, axis and Legendre polynomial", 3, scatter=Scattering.COMPANION)
    scale: AllAxes = all_axes("unit", "size by axis and Legendre polynomial", 2, scatter=Scattering.NONE)
    durations: AllAxes = all_axes("s", "length of the records", 1, scatter=Scattering.NONE)
    known: AllAxes = all_axes("unit", "usual size, by record, axis and Legendre polynomial", 3, scatter=Scattering.NONE)
    record: int = count("index of the record", default=0)

    @classmethod
    def usual(
        cls, scale: Annotated[Array, "A 3"], durations: Annotated[Array, "R"], known: Annotated[Array, "R A 3"]
    ) -> SessionZero:
        """Make a stage whose zero, drift and curvature are the known ones in every record."""
        return cls(np.zeros((len(durations), len(scale), len(SHAPES))), scale, durations, known)

    def for_record(self, index: int | None) -> Stage:
        if index is None:
            scale = np.asarray(self.scale, dtype=float)
            return SessionZero.usual(scale, np.ones(1), np.zeros((1, *scale.shape)))
        return replace(self, record=index)

    def companion_size(self, index: tuple[int, ...]) -> float:
        return float(np.asarray(self.scale, dtype=float)[index[1:]])

    def function(self, axes: int) -> Callable[[Array, Array], Array]:
        shares, scale = np.asarray(self.shares, dtype=float)[self.record], np.asarray(self.scale, dtype=float)
        duration = float(np.asarray(self.durations, dtype=float)[self.record])
        sizes = np.asarray(self.known, dtype=float)[self.record] + scale * shares
        if not sizes.any():
            return lambda u, t: u
        zero, drift, curvature = sizes.T

        def shifted(u: Array, t: Array) -> Array:
            x = 2.0 / duration * t - 1.0
            return np.asarray(u + (zero - 0.5 * curvature + x * (drift + 1.5 * curvature * x)), dtype=np.float64)

        return shifted


def digest_of(series: Sequence[Array]) -> str:
    """SHA-256 of the series of all records."""
    digest = sha256()
    for rows in series:
        digest.update(np.ascontiguousarray(rows).tobytes())
    return digest.hexdigest()


class CarriedError(Stage):
    """Known series that is added to each record: the model's error on a baseline record of the same command.

    It is data of one diagnosis and is never written to a model file.
    """

    name: ClassVar[str] = "carried_error"
    place: ClassVar[str] = "mechanics"  # What acts on the motion acts on the error too
    series: tuple[Array, ...]  # By record, measurement unit; row k belongs to t = k sample times
    index: int
    noise: tuple[Array, ...]  # By record, noise as that of the baseline records which the series still have; empty: none

    def __init__(self, series: tuple[Array, ...], record: int = 0, noise: tuple[Array, ...] = ()) -> None:
        object.__setattr__(self, "series", series)
        object.__setattr__(self, "index", record)
        object.__setattr__(self, "noise", noise)

    def noisier(self) -> CarriedError:
        """The same with as much noise of the baseline records again."""
        return CarriedError(tuple(rows + noise for rows, noise in zip(self.series, self.noise, strict=True)), self.index)

    @property
    def commutes_with_delay(self) -> bool:
        return False

    def parameters(self) -> dict[str, Any]:
        """Return a digest of the series, by which caches tell them apart."""
        return {"sha256": digest_of(self.series)}

    def for_record(self, index: int | None) -> Stage:
        return CarriedError((np.zeros((1, self.series[0].shape[1])),)) if index is None else CarriedError(self.series, index)

    def filter(self, sampling: Sampling) -> Filter:
        return SeriesAdder(self.series[self.index], sampling)

    @cached_property
    def _splines(self) -> tuple[Any, ...]:
        from scipy.interpolate import make_interp_spline  # takes long to import

        return tuple(make_interp_spline(np.arange(len(rows)), rows, k=3) for rows in self.series)

    def delayed(self, samples: Annotated[Array, "A"]) -> CarriedError:
        """The series that come later, by cubic splines: straight lines between samples would smooth all but whole samples of delay."""
        moved = []
        for rows, spline in zip(self.series, self._splines, strict=True):
            times = np.maximum(np.arange(len(rows))[:, None] - samples, 0.0)
            if len(set(samples.tolist())) == 1:
                moved.append(np.asarray(spline(times[:, 0]), dtype=np.float64))
            else:
                moved.append(np.stack([spline(column)[:, axis] for axis, column in enumerate(times.T)], axis=1))
        return CarriedError(tuple(moved), self.index)


class LackingResponse(Stage):
    """Filter for what a model's linear dynamics lack beside the plant's: y_k = u_k + Σ_j taps_j u_{k-j}.

    It is data of one diagnosis and is never written to a model file.
    """

    name: ClassVar[str] = "lacking_response"
    place: ClassVar[str] = "mechanics"
    taps: Array  # (K, A)

    def __init__(self, taps: Annotated[Array, "K A"]) -> None:
        object.__setattr__(self, "taps", taps)

    def parameters(self) -> dict[str, Any]:
        """Return a digest of the taps, by which caches tell them apart."""
        return {"sha256": digest_of((self.taps,))}

    def filter(self, sampling: Sampling) -> Filter:
        return ConvolutionFilter(self.taps, sampling.hold)


class ConvolutionFilter(Filter):
    """Streaming `LackingResponse`."""

    def __init__(self, taps: Annotated[Array, "K A"], hold: str) -> None:
        self.hold, self.taps, self.before = hold, taps, np.zeros((len(taps) - 1, taps.shape[1]))

    def settle(self, value: Array) -> Array:
        self.before[:] = value
        return np.asarray(value * (1.0 + self.taps.sum(axis=0)), dtype=np.float64)

    def process(self, block: Array) -> Array:
        known = len(self.before)
        rows = np.concatenate([self.before, block])
        self.before = rows[len(block) :]
        added = [convolved(column, taps)[known : len(rows)] for column, taps in zip(rows.T, self.taps.T, strict=True)]
        return np.asarray(block + np.stack(added, axis=1), dtype=np.float64)


def with_sensor_delay(stages: Sequence[Stage], delay: Delay, sample_time: float, axes: int) -> tuple[Stage, ...]:
    """Insert a delay of the measurement so that the model's linear stages carry it exactly, and a carried error with them."""
    samples = np.broadcast_to(np.asarray(delay.tau, dtype=float), (axes,)) / sample_time
    index = next((i for i, stage in enumerate(stages) if isinstance(stage, (CarriedError, LearnedError))), None)
    if index is None:
        return insert(tuple(stages), "sensor", delay)
    behind = [stage.delayed(samples) if isinstance(stage, CarriedError) else stage for stage in stages[index:]]
    return (*stages[:index], delay, *behind)


@dataclass(frozen=True, eq=False)
class ErrorBasis:
    """Series of a predicted error, in the measurement unit."""

    directions: tuple[Array, ...]  # By record, (N, K), or (N, A, K) of axes together

    @cached_property
    def digest(self) -> str:
        """SHA-256 of all series."""
        return digest_of(self.directions)


@dataclass(frozen=True, eq=False)
class LearnedError(Stage):
    """Predicted error of the model in each record: adds directions[record] weights, weights ~ N(0, I).

    It is data of one diagnosis and is never written to a model file.
    """

    name: ClassVar[str] = "learned_error"
    weights: AllAxes = all_axes("", "of the posterior's directions", 1, scatter=Scattering.COMPANION)
    basis: ErrorBasis | None = None
    index: int = 0  # Index of the record

    @property
    def commutes_with_delay(self) -> bool:
        return False

    def parameters(self) -> dict[str, Any]:
        """Return the weights and a digest of the series, by which caches tell them apart."""
        assert self.basis is not None
        return {"sha256": self.basis.digest, "weights": np.asarray(self.weights, dtype=float).tolist()}

    def for_record(self, index: int | None) -> Stage:
        return CarriedError((np.zeros((1, 1)),)) if index is None else replace(self, index=index)

    def filter(self, sampling: Sampling) -> Filter:
        assert self.basis is not None
        series = self.basis.directions[self.index] @ np.asarray(self.weights, dtype=float)
        return SeriesAdder(series.reshape(len(series), -1), sampling)


class SeriesAdder(Filter):
    """Streaming `CarriedError` of one record; after the end of the series its last row is added."""

    def __init__(self, series: Annotated[Array, "N A"], sampling: Sampling) -> None:
        self.hold = sampling.hold
        self.series, self.ahead, self.count = series, int(sampling.ahead or 0), 0

    def settle(self, value: Array) -> Array:
        self.count = 0
        return np.asarray(value + self.series[0], dtype=np.float64)

    def process(self, block: Array) -> Array:
        begin = self.count + self.ahead
        self.count += len(block)
        known = self.series[begin : begin + len(block)]
        output = block + self.series[-1]
        output[: len(known)] = block[: len(known)] + known
        return np.asarray(output, dtype=np.float64)
