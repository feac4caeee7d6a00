"""Stages that depend on the time since the start of the record."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hyst_control.chain.parameter import Array
from hyst_control.chain.stage import Filter, Sampling, Stage


@dataclass(frozen=True)
class TimedStage(Stage):
    """A function of the signal and of the time t (s); settling is t = 0. `function` gives it for a number of axes."""

    @property
    def commutes_with_delay(self) -> bool:
        return False

    def function(self, axes: int) -> Callable[[Array, Array], Array]:
        """f(values (N, A), times (N, 1)) -> (N, A)."""
        raise NotImplementedError

    def filter(self, sampling: Sampling) -> Filter:
        return TimedFilter(self.function(sampling.axes), sampling)


class TimedFilter(Filter):
    """Streaming `TimedStage`: the k-th value processed is the one at (k + ahead) sample times."""

    def __init__(self, function: Callable[[Array, Array], Array], sampling: Sampling) -> None:
        self.hold = sampling.hold
        self.function, self.sample_time, self.ahead = function, sampling.sample_time, sampling.first_tick
        self.count = 0

    def settle(self, value: Array) -> Array:
        self.count = 0
        first: Array = self.function(np.array(value, dtype=float).reshape(1, -1), np.zeros((1, 1)))[0]
        return first

    def process(self, block: Array) -> Array:
        ticks = self.count + self.ahead + np.arange(len(block))
        times = (ticks * self.sample_time).astype(np.float64)
        self.count += len(block)
        return self.function(block, times[:, None])
