# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Streaming regressors of a Prandtl-Ishlinskii model in front of linear dynamics, and their Gram matrices.

For given thresholds and G(s) the output is linear in all the rest: y = Σ_j θ_j G[φ_j], with φ the play operators and, for
HAMPI, the products of the dynamic weights (HAMPI paper Eq. 2-6). The regressors of a long record do not fit in memory, but
their Gram matrix is small, and sufficient for a least-squares problem: so a record is passed once, block by block.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numba import njit

from hyst_control.base.arrays import Array
from hyst_control.chain.linear.linear_lanes import LinearLanes
from hyst_control.chain.linear.linear_stages import Discretised
from hyst_control.chain.stage import Sampling
from hyst_control.identify.solve.stable_dynamics import Structure
from hyst_control.records.stream import row_store

BLOCK = 4096
MAX_BLOCKS = 2048
"""Gram matrices that a window keeps: of longer ones neighboring blocks are added up."""
HELD_OUT_BLOCKS = 90
"""A record is cut into at least this many blocks."""
NUISANCES = {"none": 0, "offset": 1, "linear": 2}


@njit(cache=True, error_model="numpy")
def regressors(
    command: Annotated[Array, "N"],
    rate_factor: float,
    center: float,
    thresholds: Array,
    release: Array,
    rate_gain: float,
    dynamic: bool,
    theta: Annotated[Array, "J"],
    operators: Annotated[Array, "1"],
    previous: Annotated[Array, "1"],
    output: Array,
) -> None:
    """Compute φ_j (J rows) and Σ θ_j φ_j."""
    count, columns = thresholds.size, theta.size
    for row in range(command.size):
        u = command[row]
        rate = (u - previous[0]) * rate_factor
        previous[0] = u
        widening = rate_gain * abs(rate)
        total = 0.0
        for i in range(count):
            low = u - thresholds[i] - widening
            high = u + release[i] + widening
            h = operators[i]
            h = high if h > high else h
            h = low if h < low else h
            operators[i] = h
            output[i, row] = h
            total += h
        if dynamic:
            output[count, row] = -rate * total if rate >= 0.0 else 0.0
            output[count + 1, row] = rate * total if rate < 0.0 else 0.0
            output[count + 2, row] = (u - center) * total
        weighted = 0.0
        for j in range(columns):
            weighted += theta[j] * output[j, row]
        output[columns, row] = weighted


def weighted_rows(
    raw: Annotated[Array, "J + P N"],
    theta: Annotated[Array, "J"],
    step: float,
    share: Annotated[Array, "N"],
    extra: int,
    measurement: Annotated[Array, "N"],
    weight: Annotated[Array, "N"] | None,
) -> Annotated[Array, "K N"]:
    """[θ columns, derivatives, nuisances, y], each row times the root of its weight."""
    columns = len(theta)
    slopes = (raw[columns:] - theta @ raw[:columns]) / step
    block = np.concatenate([raw[:columns], slopes, np.array([np.ones(len(share)), share])[:extra], measurement[None]])
    if weight is not None:
        block *= np.sqrt(weight)
    return block


@dataclass(frozen=True)
class Operators:
    """The play operators of one axis."""

    thresholds: Array  # Thresholds (n,), V
    one_sided: bool = False  # One-sided play operators
    dynamic: bool = False  # Weights that follow the command's rate and level (m1, m2, k)
    center: float = 0.0  # Command about which the level counts, V
    rate_gain: float | None = None  # Thresholds widen to r + rate_gain |du/dt| (RDPI), s; None: they do not

    @property
    def columns(self) -> int:
        """Number of linear parameters: the weights, and m1, m2, k where the weights are dynamic."""
        return len(self.thresholds) + 3 * self.dynamic

    @property
    def release(self) -> Array:
        """Distance (n,) at which an operator is pulled down, V."""
        return np.zeros_like(self.thresholds) if self.one_sided else self.thresholds


@dataclass(frozen=True)
class Window:
    """A stretch of a record."""

    command: Annotated[Array, "N"]  # Command (N,), V
    measurement: Annotated[Array, "N"]  # Measurement (N,)
    sample_time: float  # Sample time, s
    hold: str  # Command between ticks: "zoh" or "foh"
    skip: int  # First row that counts
    group: int  # Number of its record
    # Begin of the window as a fraction of its record: the drift nuisance runs over the whole record
    begin: float = 0.0
    share: float = 1.0  # Length of the window as a fraction of its record
    # The command's turning points before the window, from rest: what the play operators remember
    memory: Array | None = None
    weight: Array | None = None  # Weight of every row (N,), 1 where there is none


@dataclass(frozen=True)
class Grams:
    """Gram matrices of [θ columns, dynamics columns, nuisance columns, y]."""

    fitted: Annotated[Array, "K K"]  # Gram matrix (K, K) of the rows fitted
    held_out: Annotated[Array, "K K"]  # Gram matrix (K, K) of the rows held out
    rows: tuple[int, int]  # Numbers of rows fitted and held out
    # Gram matrices (B, K, K) of the blocks: the spread between blocks gives the standard errors
    blocks: Annotated[Array, "B K K"]


def gram_matrices(
    windows: Sequence[Window],
    operators: Operators,
    structure: Structure,
    parameters: Annotated[Array, "P"],
    theta: Annotated[Array, "J"],
    nuisance: str,
    groups: int,
    step: float = 1e-4,
) -> Grams:
    """Form the Gram matrices in one pass over every window.

    Columns: J of θ, then the derivatives by the P parameters of G, nuisances per record, y.
    """
    columns, size, extra = operators.columns, structure.size, NUISANCES[nuisance]
    total = columns + size + extra * groups + 1
    grams = np.zeros((2, total, total))
    rows = [0, 0]
    blocks: list[Array] = []
    samplings = {Sampling(window.sample_time, 1, window.hold) for window in windows}
    systems = {
        sampling: [structure.discretized(vector, sampling) for vector in (parameters, *(parameters + step * np.eye(size)))]
        for sampling in samplings
    }
    for window in windows:
        passing = _Pass(window, operators, systems[Sampling(window.sample_time, 1, window.hold)], theta)
        n = len(window.command)
        place = np.r_[0 : columns + size, columns + size + window.group * extra + np.arange(extra), total - 1]
        length = max(min(BLOCK, n // HELD_OUT_BLOCKS), 1)
        together, chunk = -(-n // (length * MAX_BLOCKS)), length * max(BLOCK // length, 1)
        sums, used_blocks = np.zeros((2, len(place), len(place))), 0
        kept: list[Array] = []
        for begin in range(0, n, chunk):
            end, first = min(begin + chunk, n), max(window.skip, begin)
            raw = passing.rows(begin, end)[:, first - begin :]
            if first >= end:
                continue
            share = window.begin - 0.5 + window.share * np.arange(first, end) / n
            weight = None if window.weight is None else window.weight[first:end]
            several = weighted_rows(raw, theta, step, share, extra, window.measurement[first:end], weight)
            for start in range(first - first % length, end, length):
                block = several[:, max(start - first, 0) : min(start + length, end) - first]
                product = block @ block.T
                # Every third block is held out of the choice between structures: a part of every experiment in the record.
                part = 1 if start // length % 3 == 2 else 0
                sums[part] += product
                rows[part] += block.shape[1]
                if used_blocks % together:
                    kept[-1] += product
                else:
                    kept.append(product)
                used_blocks += 1
        grams[:, place[:, None], place] += sums
        blocks.append(np.zeros((len(kept), total, total)))
        if kept:
            blocks[-1][:, place[:, None], place] = kept
    return Grams(grams[0], grams[1], (rows[0], rows[1]), np.concatenate(blocks))


class _Pass:
    """Streaming state of the regressors behind G, and of their sum behind the neighbors of G, over one window."""

    def __init__(self, window: Window, operators: Operators, systems: Sequence[tuple[Discretised, int]], theta: Array) -> None:
        self.window, self.operators, self.theta = window, operators, theta
        late = 1 if window.hold == "zoh" else 0  # the sample sees the command of the interval before
        every = [systems[0]] * operators.columns + list(systems[1:])
        self.lanes = LinearLanes([system for system, _ in every], [whole + late for _, whole in every])
        self.h = np.zeros(len(operators.thresholds))
        self.previous = np.array([window.command[0]])
        self._settle()

    def _settle(self) -> None:
        # The play operators' memory up to the first command, then every linear state at rest there.
        if self.window.memory is not None:
            for part in row_store.blocks(len(self.window.memory)):
                self._regressors(self.window.memory[part])
            self.previous[0] = self.window.command[0]
        self.lanes.settle(np.ravel(self._inputs(self._regressors(self.window.command[:1]))))

    def rows(self, begin: int, end: int) -> Array:
        """Columns (J + P, N) of the rows from `begin` to `end` of the window, which follow those of the call before."""
        return self.lanes.process(self._inputs(self._regressors(self.window.command[begin:end])))

    def _inputs(self, found: Array) -> list[Array]:
        """Inputs (N,) of G, a regressor each, and of its neighbors, the weighted sum of all."""
        return [found[min(lane, self.operators.columns)] for lane in range(self.lanes.count)]

    def _regressors(self, command: Array) -> Array:
        ops = self.operators
        found = np.empty((ops.columns + 1, len(command)))
        regressors(
            command,
            1.0 / self.window.sample_time,
            ops.center,
            ops.thresholds,
            ops.release,
            ops.rate_gain or 0.0,
            ops.dynamic,
            self.theta,
            self.h,
            self.previous,
            found,
        )
        return found
