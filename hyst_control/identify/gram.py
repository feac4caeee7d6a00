"""Streaming regressors of a Prandtl-Ishlinskii model in front of a linear dynamics, and their Gram matrices.

For given thresholds and G(s) the output is linear in all the rest: y = Σ_j θ_j G[φ_j], with φ the play operators and, for
HAMPI, the products of the dynamic weights (HAMPI paper Eq. 2-6). The regressors of a long record do not fit in memory, but
their Gram matrix is small, and it is all that a least-squares problem needs: so a record is passed once, block by block.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from hyst_control.chain.linear import Discretised
from hyst_control.chain.stage import Array, Sampling
from hyst_control.identify.dynamics import Structure

BLOCK = 4096
HELD_OUT_BLOCKS = 90
"""A record is cut into at least this many blocks."""
TINY = 1e-80
"""States below this are 0: a decaying state would else end in subnormal numbers, which processors handle a hundred times slower."""
NUISANCES = {"none": 0, "offset": 1, "linear": 2}


@njit(cache=True, error_model="numpy")
def filtered_regressors(command, shift, rate_factor, center, thresholds, release, rate_gain, dynamic, a, b, c, d, whole,
                        theta, pa, pb, pc, pd, pwhole, operators, previous, ring, combined, position, state, scratch, tangent,
                        output):
    """Rows of G[φ_j] (J columns) and of G_i[Σ θ_j φ_j] for P neighbouring dynamics G_i (P columns).

    command (N,) V; `shift` 1 when the sample sees the command of the interval before (zoh), else 0; rate_factor 1 / sample_time;
    thresholds, release (n,), each widened by rate_gain · |rate| (rate-dependent thresholds); `dynamic` adds the columns of m1, m2
    and k, the last around `center`. a (n, n), b (3, n), c (n,), d (2,) and `whole` samples of delay are G; pa … pwhole the same
    with a leading axis P. The remaining arrays are states. Returns the ring's position.
    """
    count, columns, order = thresholds.size, ring.shape[1], a.shape[0]
    length = ring.shape[0]
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
            ring[position, i] = h
            total += h
        if dynamic:
            ring[position, count] = -rate * total if rate >= 0.0 else 0.0
            ring[position, count + 1] = rate * total if rate < 0.0 else 0.0
            ring[position, count + 2] = (u - center) * total
        weighted = 0.0
        for j in range(columns):
            weighted += theta[j] * ring[position, j]
        combined[position] = weighted
        first = (position - shift - whole) % length
        second, third = (first - 1) % length, (first - 2) % length
        for i in range(order):
            for j in range(columns):
                scratch[i, j] = b[0, i] * ring[first, j] + b[1, i] * ring[second, j] + b[2, i] * ring[third, j]
            for m in range(order):
                for j in range(columns):
                    scratch[i, j] += a[i, m] * state[m, j]
        for i in range(order):
            for j in range(columns):
                state[i, j] = scratch[i, j] if abs(scratch[i, j]) > TINY else 0.0
        for j in range(columns):
            output[row, j] = d[0] * ring[first, j] + d[1] * ring[second, j]
        for i in range(order):
            for j in range(columns):
                output[row, j] += c[i] * state[i, j]
        for p in range(pa.shape[0]):
            first = (position - shift - pwhole[p]) % length
            second, third = (first - 1) % length, (first - 2) % length
            value = pd[p, 0] * combined[first] + pd[p, 1] * combined[second]
            for i in range(order):
                step = pb[p, 0, i] * combined[first] + pb[p, 1, i] * combined[second] + pb[p, 2, i] * combined[third]
                for m in range(order):
                    step += pa[p, i, m] * tangent[p, m]
                scratch[i, 0] = step
            for i in range(order):
                tangent[p, i] = scratch[i, 0] if abs(scratch[i, 0]) > TINY else 0.0
                value += pc[p, i] * tangent[p, i]
            output[row, columns + p] = value
        position = (position + 1) % length
    return position


@njit(cache=True, error_model="numpy")
def gram_product(block):
    """block' block of a tall block (N, K): without BLAS, whose threads spin for longer than such a product takes."""
    rows, columns = block.shape
    product = np.zeros((columns, columns))
    for row in range(rows):
        for i in range(columns):
            value = block[row, i]
            for j in range(i, columns):
                product[i, j] += value * block[row, j]
    for i in range(columns):
        for j in range(i):
            product[i, j] = product[j, i]
    return product


@dataclass(frozen=True)
class Operators:
    """The play operators of one axis: thresholds (n,) V; rate_gain s: thresholds widen to r + rate_gain |du/dt| (RDPI)."""

    thresholds: Array
    one_sided: bool = False
    dynamic: bool = False
    center: float = 0.0
    rate_gain: float = 0.0

    @property
    def columns(self) -> int:
        """Number of linear parameters: the weights, and m1, m2, k where the weights are dynamic."""
        return len(self.thresholds) + 3 * self.dynamic

    @property
    def release(self) -> Array:
        """Distance at which an operator is pulled down."""
        return np.zeros_like(self.thresholds) if self.one_sided else self.thresholds


@dataclass(frozen=True)
class Window:
    """A stretch of a record: command (N,), measurement (N,), counted from row `skip` on; `group` numbers its record."""

    command: Array
    measurement: Array
    sample_time: float
    hold: str
    skip: int
    group: int
    begin: float = 0.0
    """Where the window begins within its record, as a share of it: the drift nuisance runs over the whole record."""
    share: float = 1.0
    """The window's length as a share of its record."""
    memory: Array | None = None
    """The command's turning points before the window, from rest: what the play operators remember."""
    weight: Array | None = None
    """Weight of every row (N,), 1 where there is none."""


@dataclass(frozen=True)
class Grams:
    """Gram matrices of [θ columns, dynamics columns, nuisance columns, y], for the rows fitted and the rows held out."""

    fitted: Array
    held_out: Array
    rows: tuple[int, int]
    blocks: Array
    """The Gram matrix of every block by itself (B, K, K): how much the blocks disagree says how sure the parameters are."""


def gram_matrices(windows: Sequence[Window], operators: Operators, structure: Structure, parameters: Array, theta: Array,
                  nuisance: str, groups: int, step: float = 1e-4) -> Grams:
    """Pass every window once. Columns: J of θ, then the derivatives by the P parameters of G, nuisances per record, y."""
    columns, size, extra = operators.columns, structure.size, NUISANCES[nuisance]
    total = columns + size + extra * groups + 1
    grams = np.zeros((2, total, total))
    rows = [0, 0]
    blocks = []
    for window in windows:
        passing = _Pass(window, operators, structure, parameters, theta, step)
        n = len(window.command)
        place = np.r_[0:columns + size, columns + size + window.group * extra + np.arange(extra), total - 1]
        length = max(min(BLOCK, n // HELD_OUT_BLOCKS), 1)
        for begin in range(0, n, length):
            end = min(begin + length, n)
            raw = passing.block(begin, end)
            used = slice(max(window.skip - begin, 0), end - begin)
            if used.start >= used.stop:
                continue
            block = np.empty((used.stop - used.start, columns + size + extra + 1))
            block[:, :columns] = raw[used, :columns]
            block[:, columns:columns + size] = (raw[used, columns:] - (raw[used, :columns] @ theta)[:, None]) / step
            share = window.begin + window.share * np.arange(begin + used.start, end) / n
            for power in range(extra):
                block[:, columns + size + power] = (share - 0.5) ** power
            block[:, -1] = window.measurement[begin + used.start:end]
            # Every third block is held out of the choice between structures: little of every experiment in the record.
            part = 1 if begin // length % 3 == 2 else 0
            if window.weight is not None:
                block *= np.sqrt(window.weight[begin + used.start:end, None])
            product = gram_product(block)
            grams[part][np.ix_(place, place)] += product
            rows[part] += len(block)
            blocks.append(np.zeros((total, total)))
            blocks[-1][np.ix_(place, place)] = product
    return Grams(grams[0], grams[1], (rows[0], rows[1]), np.array(blocks))


class _Pass:
    """Streaming state of `filtered_regressors` over one window."""

    def __init__(self, window: Window, operators: Operators, structure: Structure, parameters: Array, theta: Array,
                 step: float) -> None:
        sampling = Sampling(window.sample_time, 1, window.hold)
        nominal = structure.discretised(parameters, sampling)
        neighbours = [structure.discretised(parameters + step * unit, sampling) for unit in np.eye(structure.size)]
        self.window, self.operators, self.theta = window, operators, theta
        self.shift = 1 if window.hold == "zoh" else 0
        order, columns = len(nominal[0].A), operators.columns
        wholes = [whole for _, whole in (nominal, *neighbours)]
        self.nominal = _arrays([nominal[0]])
        self.neighbours = _arrays([system for system, _ in neighbours]) if neighbours else tuple(
            np.zeros((0, *part.shape[1:])) for part in self.nominal)
        self.whole, self.pwhole = wholes[0], np.array(wholes[1:], dtype=np.int64)
        self.h = np.zeros(len(operators.thresholds))
        self.previous = np.array([window.command[0]])
        length = max(wholes) + 5
        self.ring, self.combined = np.zeros((length, columns)), np.zeros(length)
        self.state, self.scratch = np.zeros((order, columns)), np.zeros((max(order, 1), columns))
        self.tangent = np.zeros((structure.size, order))
        self.position = 0
        self._settle()

    def _settle(self) -> None:
        # The play operators' memory up to the first command, then every linear state at rest there.
        if self.window.memory is not None:
            self.block_of(self.window.memory)
            self.previous[0] = self.window.command[0]
        self.block_of(self.window.command[:1])
        first = self.ring[(self.position - 1) % len(self.ring)].copy()
        self.ring[:], self.combined[:] = first, first @ self.theta
        a, b = self.nominal[0][0], self.nominal[1][0]
        order = len(a)
        if order:
            gain = np.linalg.solve(np.eye(order) - a, b.sum(axis=0))
            self.state[:] = gain[:, None] * first
            for p in range(len(self.tangent)):
                self.tangent[p] = np.linalg.solve(np.eye(order) - self.neighbours[0][p], self.neighbours[1][p].sum(axis=0))
                self.tangent[p] *= first @ self.theta

    def block(self, begin: int, end: int) -> Array:
        return self.block_of(self.window.command[begin:end])

    def block_of(self, command: Array) -> Array:
        output = np.empty((len(command), self.ring.shape[1] + len(self.tangent)))
        ops = self.operators
        a, b, c, d = (part[0] for part in self.nominal)
        self.position = filtered_regressors(
            command, self.shift, 1.0 / self.window.sample_time, ops.center, ops.thresholds, ops.release, ops.rate_gain,
            ops.dynamic, a, b, c, d, self.whole, self.theta, *self.neighbours, self.pwhole, self.h, self.previous, self.ring,
            self.combined, self.position, self.state, self.scratch, self.tangent, output)
        return output


def _arrays(systems: list[Discretised]) -> tuple[Array, Array, Array, Array]:
    """Single-input systems as stacked arrays a (S, n, n), b (S, 3, n), c (S, n), d (S, 2)."""
    return (np.array([s.A for s in systems]), np.array([s.B[:, :, 0] for s in systems]),
            np.array([s.C[0] for s in systems]), np.array([s.D[:, 0, 0] for s in systems]))
