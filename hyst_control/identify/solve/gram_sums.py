# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Streaming regressors of a Prandtl-Ishlinskii model in front of linear dynamics, and their Gram matrices.

For given thresholds and G(s) the output is linear in all the rest: y = Σ_j θ_j G[φ_j], with φ the play operators and, for
HAMPI, the products of the dynamic weights (HAMPI paper Eq. 2-6). Where every weight changes with the command by an amount of its own,
there are two of each operator, φ (1 - s)/2 and φ (1 + s)/2, with s = -1 … 1 the command within its range: θ are the weights at its ends.
The regressors of a long record do not fit in memory, but their Gram matrix is small, and sufficient for a least-squares problem: so a
record is passed once, block by block.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numba import njit

from hyst_control.base.arrays import Array
from hyst_control.chain.linear.linear_lanes import LinearLanes
from hyst_control.chain.linear.linear_stages import Discretised
from hyst_control.chain.stage import Sampling
from hyst_control.identify.solve.stable_dynamics import Structure
from hyst_control.records.stream import row_store

BLOCK = 4000
"""Rows that are computed at once: no power of two, at which all columns would share a few places of the cache."""
MAX_BLOCKS = 2048  # Gram matrices that a window keeps: of longer ones neighboring blocks are added up
HELD_OUT_BLOCKS = 90  # A record is cut into at least this many blocks
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
    reach: float,
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
        weights = count
        for i in range(count):
            if thresholds[i] < reach:
                output[weights, row] = (0.5 + 0.5 * (u - center) / reach) * output[i, row]
                output[i, row] -= output[weights, row]
                weights += 1
        if dynamic:
            output[weights, row] = -rate * total if rate >= 0.0 else 0.0
            output[weights + 1, row] = rate * total if rate < 0.0 else 0.0
            if reach == 0.0:
                output[weights + 2, row] = (u - center) * total
        weighted = 0.0
        for j in range(columns):
            weighted += theta[j] * output[j, row]
        output[columns, row] = weighted


@dataclass(frozen=True)
class Operators:
    """The play operators of one axis."""

    thresholds: Array  # Thresholds (n,), V
    one_sided: bool = False  # One-sided play operators
    dynamic: bool = False  # Weights that follow the command's rate and level (m1, m2, k)
    center: float = 0.0  # Command about which the level counts, V
    rate_gain: float | None = None  # Thresholds widen to r + rate_gain |du/dt| (RDPI), s; None: they do not
    # Half the range of the command, V, over which the weight of every operator that moves in a cycle changes by an amount of its own,
    # which takes the place of k; 0: none does
    reach: float = 0.0

    @property
    def weights(self) -> int:
        """Number of weights: one of each operator, at the lower end of the command's range where there is a second one at the upper end."""
        return len(self.thresholds) + int(np.count_nonzero(self.thresholds < self.reach))

    @property
    def columns(self) -> int:
        """Number of linear parameters: the weights, and m1, m2 and, where no weight changes by its own, k where they are dynamic."""
        return self.weights + self.dynamic * (2 if self.reach else 3)

    def split(self, theta: Annotated[Array, "J"]) -> tuple[Array, Array, Array]:
        """Weights (n,) at the center of the command's range, change of each with the command (n,), and the rest of the parameters."""
        n, low, high = len(self.thresholds), theta[: len(self.thresholds)], theta[: len(self.thresholds)].copy()
        high[: self.weights - n] = theta[n : self.weights]
        return 0.5 * (low + high), 0.5 * (high - low) / (self.reach or 1.0), theta[self.weights :]

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
    grams, rows = np.zeros((2, total, total)), np.zeros(2, dtype=int)
    blocks: list[Array] = []
    samplings = {Sampling(window.sample_time, 1, window.hold) for window in windows}
    systems = {
        sampling: [structure.discretized(vector, sampling) for vector in (parameters, *(parameters + step * np.eye(size)))]
        for sampling in samplings
    }
    for window in windows:
        n = len(window.command)
        length = max(min(BLOCK, n // HELD_OUT_BLOCKS), 1)
        together = -(-n // (length * MAX_BLOCKS))
        place = np.r_[0 : columns + size, columns + size + window.group * extra + np.arange(extra), total - 1]
        passing = _Pass(window, operators, systems[Sampling(window.sample_time, 1, window.hold)], theta, step, extra)
        sums = np.zeros((2, len(place), len(place)))
        kept = np.zeros((-(-(-(-n // length) - window.skip // length) // together), len(place), len(place)))
        for begin in range(0, n, length * max(BLOCK // length, 1)):
            end = min(begin + length * max(BLOCK // length, 1), n)
            table = passing.table(begin, end, length)
            if end <= window.skip:
                continue
            products = table.transpose(1, 0, 2) @ table.transpose(1, 2, 0)
            number = np.arange(begin // length, -(-end // length))
            # Every third block is held out of the choice between structures: a part of every experiment in the record.
            held = number % 3 == 2
            sums += [products[~held].sum(axis=0), products[held].sum(axis=0)]
            counted = np.minimum((number + 1) * length, n) - np.maximum(number * length, window.skip)
            rows += [np.maximum(counted, 0)[~held].sum(), np.maximum(counted, 0)[held].sum()]
            used = counted > 0
            np.add.at(kept, (number[used] - window.skip // length) // together, products[used])
        grams[:, place[:, None], place] += sums
        blocks.append(np.zeros((len(kept), total, total)))
        blocks[-1][:, place[:, None], place] = kept
    return Grams(grams[0], grams[1], (int(rows[0]), int(rows[1])), np.concatenate(blocks))


def weighted_operators(window: Window, operators: Operators, theta: Annotated[Array, "J"]) -> Annotated[Array, "N"]:
    """Σ θ_j φ_j over a window: what enters the dynamics."""
    at_once = Structure().discretized(np.zeros(0), Sampling(window.sample_time, 1, window.hold))
    found: Array = _Pass(window, operators, [at_once], theta, 1.0, 0).operators_of(window.command)[-1]
    return found


def simulated_rows(
    window: Window, operators: Operators, structure: Structure, parameters: Annotated[Array, "P"], theta: Annotated[Array, "J"]
) -> Annotated[Array, "N"]:
    """The model's answer over a window, 0 in the rows that do not count."""
    system = structure.discretized(parameters, Sampling(window.sample_time, 1, window.hold))
    rows = len(window.command)
    table = _Pass(replace(window, weight=None), operators, [system], theta, 1.0, 0).table(0, rows, rows)
    return np.asarray(theta @ table[: operators.columns, 0])


class _Pass:
    """Streaming state of the regressors behind G, and of their sum behind the neighbors of G, over one window."""

    def __init__(
        self,
        window: Window,
        operators: Operators,
        systems: Sequence[tuple[Discretised, int]],
        theta: Array,
        step: float,
        extra: int,
    ) -> None:
        self.window, self.operators, self.theta, self.step, self.extra = window, operators, theta, step, extra
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
                self.operators_of(self.window.memory[part])
            self.previous[0] = self.window.command[0]
        self.lanes.settle(np.ravel(self._inputs(self.operators_of(self.window.command[:1]))))

    def table(self, begin: int, end: int, length: int) -> Annotated[Array, "K B length"]:
        """[θ columns, derivatives, nuisances, y] of the next rows, each times the root of its weight, 0 where a row does not count."""
        window, columns, lanes = self.window, self.operators.columns, self.lanes.count
        count, first = end - begin, min(max(window.skip - begin, 0), end - begin)
        table = np.zeros((lanes + self.extra + 1, -(-count // length) * length))
        self.lanes.process(self._inputs(self.operators_of(window.command[begin:end])), table[:lanes, :count])
        table[:, :first] = 0.0
        table[columns:lanes, first:count] -= self.theta @ table[:columns, first:count]
        table[columns:lanes, first:count] /= self.step
        share = window.begin - 0.5 + window.share * np.arange(begin + first, end) / len(window.command)
        table[lanes:-1, first:count] = np.array([np.ones(len(share)), share])[: self.extra]
        table[-1, first:count] = window.measurement[begin + first : end]
        if window.weight is not None:
            table[:, first:count] *= np.sqrt(window.weight[begin + first : end])
        return table.reshape(len(table), -1, length)

    def _inputs(self, found: Array) -> list[Array]:
        """Inputs (N,) of G, a regressor each, and of its neighbors, the weighted sum of all."""
        return [found[min(lane, self.operators.columns)] for lane in range(self.lanes.count)]

    def operators_of(self, command: Array) -> Array:
        """φ_j (J rows) and their weighted sum for the next commands."""
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
            ops.reach,
            self.theta,
            self.h,
            self.previous,
            found,
        )
        return found
