# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Stages that depend on the time since the start of the record."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.chain.c_code.c_code import CCode, reals
from hyst_control.chain.stage import Filter, Role, Sampling, Stage

STEP = """
const double t = (s->count + p->ahead) * p->sample_time;
s->count += 1.0;
BODY
"""

SETTLE = """
const double t = 0.0;
s->count = 0.0;
BODY
"""


@dataclass(frozen=True)
class TimedStage(Stage):
    """A function of the signal and of the time t (s); settling is t = 0. `function` gives it for a number of axes."""

    ROLES: ClassVar[Role] = Role.CHANGES_WITH_TIME

    def function(self, axes: int) -> Callable[[Array, Array], Array]:
        """f(values (N, A), times (N, 1)) -> (N, A)."""
        raise NotImplementedError

    def function_in_c(self, axes: int) -> CCode | None:
        """The same in C of the input `u` and the time `t` (s, double) of the axis `i`; None where it has none."""
        return None

    def filter(self, sampling: Sampling) -> Filter:
        return TimedFilter(self.function(sampling.axes), sampling, self.function_in_c(sampling.axes))


class TimedFilter(Filter):
    """Streaming `TimedStage`: the k-th value processed is the one at (k + ahead) sample times."""

    def __init__(self, function: Callable[[Array, Array], Array], sampling: Sampling, code: CCode | None = None) -> None:
        self.hold = sampling.hold
        self.code = code
        self.function, self.sample_time, self.ahead = function, sampling.sample_time, sampling.first_tick
        self.count = 0

    def settle(self, value: Array) -> Array:
        self.count = 0
        return np.asarray(self.function(np.array(value, dtype=float).reshape(1, -1), np.zeros((1, 1)))[0])

    def process(self, block: Array) -> Array:
        begin = self.count + self.ahead
        times = np.arange(begin, begin + len(block)) * self.sample_time
        self.count += len(block)
        return self.function(block, np.asarray(times[:, None], dtype=np.float64))

    def c_code(self) -> CCode:
        if self.code is None:
            return super().c_code()
        timing = {"sample_time": reals(self.sample_time, "s", wide=True), "ahead": reals(self.ahead, "ticks", wide=True)}
        return replace(
            self.code,
            step=STEP.replace("BODY", self.code.step.strip()),
            settle=SETTLE.replace("BODY", self.code.step.strip()),
            constants={**self.code.constants, **timing},
            state={"count": reals(0.0, "ticks since it was settled", wide=True)},
        )
