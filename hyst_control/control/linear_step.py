# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Unit step of the linear loop from its state matrix: of any length, since the samples grow sparse as time goes on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.chain import Stage
from hyst_control.chain.linear.linear_stages import Delay
from hyst_control.control.feedback.filters import Section
from hyst_control.control.feedback.pi import PI
from hyst_control.control.state_space import Discrete, beside, state_space, then

DENSE = 1024  # Samples of the first stretch; every further one, twice as long, has half as many at twice the distance
STRETCHES = 50
SETTLED, DIVERGED, CONSTANT = 1e-4, 1e6, 1e-9  # Errors, and motion, of a whole stretch at which the step is over


@dataclass(frozen=True)
class Step:
    """Answer of a loop to a reference that jumps from 0 to 1: ticks (N,), and the measurement (N, A) there."""

    ticks: Array
    measurement: Array

    @property
    def overshoot(self) -> float:
        """Overshoot of the worst axis, percent."""
        return round(float(100.0 * max(self.measurement.max() - 1.0, 0.0)), 9)  # less is the error of the arithmetic

    def settling_ticks(self) -> float:
        """Ticks until every axis stays within 2 %; NaN where one does not."""
        outside = np.flatnonzero(~np.all(np.abs(self.measurement - 1.0) <= 0.02, axis=1))
        last = int(outside[-1]) if len(outside) else -1
        return float(self.ticks[last + 1]) if last + 1 < len(self.ticks) else np.nan

    @property
    def absolute_error(self) -> float:
        """Integral of the absolute error of the worst axis, ticks."""
        return float((np.abs(self.measurement - 1.0) * np.diff(self.ticks, append=self.ticks[-1] + 1)[:, None]).sum(axis=0).max())


@np.errstate(all="ignore")  # a loop that is not stable grows without bound
def linear_step(stages: Sequence[Stage], axes: int, law: PI, loop_delay: int = 0) -> Step:
    """Step of a law around linear stages, with a further delay of the loop in ticks."""
    late = [Delay(loop_delay * law.sample_time)] if loop_delay else []
    matrix, state, output = _autonomous(state_space([*late, *stages], axes, law.sample_time), axes, law)
    ticks: list[Array] = []
    measurement: list[Array] = []
    begin, stride, count = 0, 1, DENSE
    for _ in range(STRETCHES):
        found, state = _samples(matrix, state, output, count)
        ticks.append(begin + stride * np.arange(count, dtype=float))
        measurement.append(found)
        if not SETTLED < np.abs(found - 1.0).max() < DIVERGED or np.ptp(found, axis=0).max() < CONSTANT:
            break
        begin += stride * count
        matrix, stride, count = matrix @ matrix, 2 * stride, DENSE // 2
    return Step(np.concatenate(ticks), np.concatenate(measurement))


def law_sections(law: PI) -> tuple[list[Section], list[Section]]:
    """A law as sections: those that the error passes one after the other, and those beside each other behind them."""
    rolled = [Section(law.roll_off_share, a1=law.roll_off_share - 1.0)] if law.roll_off else []
    step = law.ki * law.sample_time
    core = Section(law.kp + step, -law.kp, a1=-1.0) if law.ki else Section(law.kp)
    return [*law.filters.notches(law.sample_time), *rolled], [core, *law.filters.beside(law.sample_time)]


def _autonomous(plant: Discrete, axes: int, law: PI) -> tuple[Array, Array, Array]:
    """Matrix, first state and output rows of the loop with the reference 1 as its last state."""
    in_series, parallel = law_sections(law)
    unchanged = Discrete(np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0)), np.eye(1))
    passed = reduce(then, map(_realized, in_series), unchanged)
    together = beside([_realized(section) for section in parallel])
    control = Discrete._make(np.kron(np.eye(axes), matrix) for matrix in then(passed, together))
    one = np.ones((axes, 1))
    pushed = plant.b @ control.d
    matrix = np.block(
        [
            [plant.a - pushed @ plant.c, plant.b @ control.c, pushed @ one],
            [-control.b @ plant.c, control.a, control.b @ one],
            [np.zeros((1, len(plant.a) + len(control.a))), np.ones((1, 1))],
        ]
    )
    output = np.hstack([plant.c, np.zeros((axes, len(control.a) + 1))])
    state = np.zeros(len(matrix))
    state[-1] = 1.0
    return matrix, state, output


def _realized(section: Section) -> Discrete:
    b0, b1, b2, a1, a2 = section
    return Discrete(
        np.array([[-a1, 1.0], [-a2, 0.0]]), np.array([[b1 - a1 * b0], [b2 - a2 * b0]]), np.array([[1.0, 0.0]]), np.array([[b0]])
    )


def _samples(matrix: Array, state: Array, output: Array, count: int) -> tuple[Array, Array]:
    """Outputs (count, A) of as many steps by the matrix, and the state after them; several steps by one product."""
    together = 32
    rows = [output]
    for _ in range(together - 1):
        rows.append(rows[-1] @ matrix)
    block, far = np.vstack(rows), np.linalg.matrix_power(matrix, together)
    found = []
    for _ in range(count // together):
        found.append((block @ state).reshape(together, -1))
        state = far @ state
    return np.concatenate(found), state
