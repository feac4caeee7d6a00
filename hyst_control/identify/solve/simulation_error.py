# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Least squares on the simulation error of any chain, with linear inequality constraints on its parameters.

The chain itself is run, so the fit is to the output of the model file. Derivatives are differences between chains of
neighboring parameters, streamed side by side over the records block by block; the data for a step are kept as Gram matrices, from
which offset, drift and initial state of every record are eliminated.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import nnls

from hyst_control.base.arrays import Array
from hyst_control.chain import Sampling, Stage
from hyst_control.identify.solve import gauss_newton
from hyst_control.identify.solve.bounded_least_squares import covariance
from hyst_control.identify.solve.chain_batch import Bundle
from hyst_control.identify.solve.gauss_newton import End, Rules, Trial
from hyst_control.identify.solve.gram_sums import HELD_OUT_BLOCKS, MAX_BLOCKS, NUISANCES, Grams, Window
from hyst_control.records.stream.row_store import blocks as row_blocks
from hyst_control.records.stream.row_store import empty_rows

BLOCK, CHUNK = 4000, 32000
"""Largest number of rows of one block's Gram matrix, and rows simulated at a time: no powers of two, at which all columns would share a
few places of the cache."""
STEP = 1e-5  # Difference of neighboring parameters, which are all of order one
DRIFT = 0.02
"""Usual drift over a record, as a share of its range: its prior, which keeps it from the slow part of the plant's response."""
FREE_MOTION = 10.0
"""Usual size (rms) of what an initial state does beside an offset, in ranges of the measurement: states of nearly equal poles would grow
without limit. Beside an offset, as the state of an integrator is mostly one: a large one decays slowly, and is a small drift."""
ROUNDING = 1e-15  # Relative size of rounding in a sum of squares
PRIOR = 1e-10
"""Weight of the prior on every parameter relative to the strongest one: determines only directions that the data do not show at all."""


@dataclass(frozen=True)
class Parametrization:
    """Chain of a parameter vector (P,) of order one, and the constraints lhs · parameters >= rhs."""

    stages: Callable[[Array], Sequence[Stage]]
    lhs: Array | None = None
    rhs: Array | None = None
    limit: Callable[[Array], Array] = staticmethod(lambda vector: vector)

    def part(self, whole: Array, free: slice) -> Parametrization:
        """Some of the parameters, without constraints; the others stay as they are in `whole`."""

        def completed(vector: Array) -> Array:
            found = whole.copy()
            found[free] = vector
            return found

        return Parametrization(
            lambda vector: self.stages(completed(vector)), limit=lambda vector: self.limit(completed(vector))[free]
        )


@dataclass(frozen=True)
class Solution:
    """Solution of a simulation-error fit."""

    parameters: Array
    nuisances: Array  # Offset and drift of every record, one record behind the other
    states: Array  # Initial state of every window beside rest, where it is unknown
    fitted: float
    held_out: float  # Mean square errors on the rows fitted and held out
    grams: Grams  # Gram matrices of [derivatives, error], the session effects eliminated
    linearized: Array  # Parameters at which the derivatives in `grams` were taken: these, or those one step before
    energies: Array  # Square errors of the blocks held out, of all where long records have neighboring blocks added up

    @property
    def covariance(self) -> Array:
        """Covariance (P, P) of the parameters, errors of the model included."""
        return covariance(self.grams.blocks, self.parameters - self.linearized)


def minimize_simulation_error(
    windows: Sequence[Window],
    parametrization: Parametrization,
    start: Array,
    *,
    nuisance: str = "linear",
    unknown_state: bool = False,
    passes: int = 12,
    tolerance: float = 1e-4,
    everything: bool = False,
    alike: bool = False,
) -> Solution:
    """Fit a chain's parameters to records by damped Gauss-Newton. Never worse than the start.

    A pass with derivatives is done at every parameter vector that lowered the cost, but for the last; whether one does is tried by a
    pass without. unknown_state: the linear dynamics at the end of the chain need not be at rest when a window begins; tolerance: share
    of the cost that a step must gain for the search to go on; everything: fit also the rows held out for choosing structures.
    """
    origin = parametrization.limit(np.asarray(start, dtype=float))
    problem = SimulationError(windows, parametrization, nuisance, unknown_state, everything, alike, origin)
    rules = Rules(
        damping=1e-3,
        raised=lambda damping: damping * 10.0,
        eased=lambda damping: max(0.1 * damping, 1e-9),
        small=lambda before, after: 1.0 - after / before < tolerance,
        confident=1e-6,
        steps=passes - 1,
        highest=1e4,
        min_move=1e-8,
    )
    found = gauss_newton.minimize(problem, problem.visit(origin, derivatives=True), rules)
    return found.point if found.linearized or found.end is End.BUDGET else problem.linearize(found.point)


@dataclass(frozen=True)
class SimulationError:
    """The error of a chain on records as a least-squares problem; a point is a `Solution`, whose Gram matrices hold the derivatives.

    Effects of a session, an offset and a drift (a name of `NUISANCES`) and an unknown state of the dynamics, are eliminated record by
    record, so a fit does not grow with the number of its records. The drift has a prior of its size.
    """

    windows: Sequence[Window]
    parametrization: Parametrization
    nuisance: str = "linear"
    unknown_state: bool = False
    everything: bool = True  # True: cost and session effects are those of all rows, the held-out ones included
    alike: bool = False  # Whether errors are alike throughout a block, which then counts as one row against the prior of the drift
    origin: Array | float = 0.0  # Parameters that the prior pulls to

    def cost(self, point: Solution) -> float:
        """Return the mean square error of the `point`."""
        return point.fitted

    def linearize(self, point: Solution) -> Solution:
        """Return the `point` with the derivatives there."""
        found = self.visit(point.parameters, derivatives=True, states=point.states)
        return replace(point, grams=found.grams, linearized=point.parameters)

    def step(self, point: Solution, damping: float) -> Trial[Solution]:
        """Return the trial of the step with `damping` from a linearized `point`."""
        grams = point.grams
        gram = grams.fitted + grams.held_out if self.everything else grams.fitted
        step = _step(gram, self.parametrization, point.parameters, self.origin, damping)
        # Shortened as a whole, so that it stays between two vectors that satisfy the constraints.
        step /= max(1.0, float(np.max(np.abs(step))))
        found = self.visit(self.parametrization.limit(point.parameters + step))
        return Trial(replace(found, grams=grams, linearized=point.parameters), float(np.max(np.abs(step))))

    def visit(self, parameters: Array, *, derivatives: bool = False, states: Array | None = None) -> Solution:
        """Simulate the records once: errors, and the Gram matrices of [derivatives (P), error]; every third block is held out.

        states: the initial states there, where they are known. Derivatives are those of the motion that begins with them: the drift of an
        integrator that does not begin at rest changes with its parameters as much as its answer to the command.
        """
        if states is None:
            states = self.visit(parameters, states=np.zeros(0)).states if derivatives and self.unknown_state else np.zeros(0)
        windows, size = self.windows, len(parameters) * derivatives
        vectors = [parameters, *(parameters + STEP * unit for unit in np.eye(len(parameters))[:size])]
        chains = [tuple(self.parametrization.stages(vector)) for vector in vectors]
        clocks = {
            sampling: Bundle(chains, sampling) for sampling in {Sampling(window.sample_time, 1, window.hold) for window in windows}
        }
        everywhere = sum(len(window.command) for window in windows)
        length = int(np.clip(everywhere // HELD_OUT_BLOCKS, 1, BLOCK))
        together = -(-everywhere // (length * MAX_BLOCKS))
        grams, rows, count = np.zeros((2, size + 1, size + 1)), np.zeros(2, dtype=int), 0
        blocks: list[Array] = []
        energies: list[Array] = []
        nuisances: list[Array] = []
        moved: list[Array] = []
        extra = NUISANCES[self.nuisance]
        for group in range(max(window.group for window in windows) + 1):
            record = [window for window in windows if window.group == group]
            if not record:  # a record of which no stretch was chosen
                nuisances.append(np.zeros(extra))
                continue
            running = [clocks[Sampling(window.sample_time, 1, window.hold)] for window in record]
            own_states = running[0].states * self.unknown_state
            columns = extra + own_states * len(record)
            total = size + columns + 1
            sums, own, first = np.zeros((2, total, total)), np.zeros(2, dtype=int), count
            pieces: list[Array] = []
            # Taken away before anything is squared: an absolute position, or the rest of a slow plant, may be millions of times the motion.
            zero, rest = (float(record[0].measurement[0]) if extra else 0.0), np.zeros(size + 1)
            if extra:
                rest = running[0].settle(float(driving_signal(record[0])[0][0, 0]))
            for number, window in enumerate(record):
                begin = sum(map(len, moved)) + number * own_states
                place = _Place(
                    size, extra, columns, number * own_states, zero, rest, len(record) == 1, states[begin : begin + own_states]
                )
                for chunk in self._chunks(window, running[number], place):
                    for product, height in _products(chunk, length):
                        if (count - first) % together:
                            pieces[-1] += product
                        else:
                            pieces.append(product)
                        count += 1
                        held_out = int((count - first) % 3 == 0)  # never a record's first rows, which determine its initial state
                        sums[held_out] += product
                        own[held_out] += height
            known, used = (sums.sum(axis=0), own.sum()) if self.everything else (sums[0], own[0])
            span = max(float(np.ptp(window.measurement)) for window in record)
            effects, penalty = _eliminated(known, size, extra, span, int(used), length if self.alike else 1)
            keep = np.vstack([np.eye(size, size + 1), -effects, np.eye(1, size + 1, size)])
            grams[0] += _kept(sums[0], keep) + penalty
            grams[1] += _kept(sums[1], keep)
            kept = _kept(np.reshape(pieces, (-1, total, total)), keep)
            blocks.append(kept)
            energies.append((kept[2::3] if together == 1 else kept)[:, -1, -1])
            moved.append(effects[extra:, -1])
            nuisances.append(effects[:extra, -1] + (zero - rest[0]) * (np.arange(extra) == 0))
            rows += own
        chosen, counted = (grams.sum(axis=0), rows.sum()) if self.everything else (grams[0], rows[0])
        return Solution(
            parameters,
            np.concatenate(nuisances),
            np.concatenate([np.zeros(0), *moved]),
            max(float(chosen[-1, -1]), 0.0) / max(int(counted), 1),
            max(float(grams[1, -1, -1]), 0.0) / max(int(rows[1]), 1),
            Grams(grams[0], grams[1], (int(rows[0]), int(rows[1])), np.concatenate(blocks)),
            parameters,
            np.concatenate(energies),
        )

    def _chunks(self, window: Window, running: Bundle, place: _Place) -> Iterator[Array]:
        """Rows of [derivatives, session effects, error] of a window that count, chunk by chunk."""
        signal, first = driving_signal(window)
        running.settle(float(signal[0, 0]))
        n, size, extra = len(window.command), place.size, place.extra
        motions = running.free_motions() if self.unknown_state else None
        begin = max(first - CHUNK, 0)  # few turning points pass together with the rows behind them
        for earlier in row_blocks(begin):
            running.process(signal[earlier])
        for chunk in range(0, n, CHUNK):
            stop = min(chunk + CHUNK, n)
            nominal, *neighbours = (found[chunk - stop :] for found in running.process(signal[begin : first + stop]))
            begin = first + stop
            rows = np.zeros((stop - chunk, size + place.columns + 1), order="F")
            for i, neighbour in enumerate(neighbours):
                # Large rests are subtracted first: their difference alone is that of a constant.
                np.subtract(neighbour - place.rest[i + 1], nominal - place.rest[0], out=rows[:, i])
            if motions is not None and motions.states:
                own = slice(size + extra + place.begin, size + extra + place.begin + motions.states)
                rows[:, own] = -motions.first * place.takes_constants
                if not motions.is_over:
                    free, moved = motions.rows(stop - chunk, place.state)
                    rows[:, own] += free
                    rows[:, : moved.shape[1]] += moved
            rows[:, :size] /= STEP
            share = window.begin + window.share * np.arange(chunk, stop) / n
            for power in range(extra):
                rows[:, size + power] = (share - 0.5) ** power
            np.subtract(window.measurement[chunk:stop] - place.zero, nominal - place.rest[0], out=rows[:, -1])
            yield rows[max(window.skip - chunk, 0) :]


@dataclass(frozen=True)
class _Place:
    """Columns of a window among those of its record, and what counts as 0 in them."""

    size: int  # Number of derivatives, which come first
    extra: int  # Number of offset and drift, which follow
    columns: int  # Number of session effects, initial states included
    begin: int  # Number of initial states of earlier windows
    zero: float  # Measurement that counts as 0
    rest: Array  # Outputs of the chains that count as 0
    alone: bool  # Whether the record has one window
    state: Array  # Initial state beside rest; empty where derivatives are those from rest

    @property
    def takes_constants(self) -> bool:
        """True where a constant of the window's initial states is one of the record's offset."""
        return self.alone and self.extra > 0


def _products(rows: Annotated[Array, "N C"], length: int) -> Iterator[tuple[Array, int]]:
    """The Gram matrix of every block of at most `length` rows, and its number of rows."""
    whole = len(rows) // length
    blocks = rows[: whole * length].reshape(whole, length, rows.shape[1])
    for product in np.matmul(blocks.transpose(0, 2, 1), blocks):
        yield product, length
    if rest := len(rows) - whole * length:
        yield rows[-rest:].T @ rows[-rest:], rest


def _kept(grams: Annotated[Array, "... T T"], keep: Array) -> Array:
    """Gram matrices without the session effects; what is left of the error is no smaller than the rounding of what was there."""
    found = np.asarray(keep.T @ grams @ keep, dtype=float)
    found[..., -1, -1] = np.maximum(found[..., -1, -1], ROUNDING * grams[..., -1, -1])
    return found


def _eliminated(gram: Array, size: int, extra: int, span: float, rows: int, alike: int) -> tuple[Array, Array]:
    """Session effects (S, P + 1) that follow the derivatives and the error, and what their prior adds to the cost (P + 1, P + 1).

    `extra` of them are offset and drift, the others initial states; span: range of the measurement; alike: rows that count as one.
    """
    part = slice(size, len(gram) - 1)
    inner, cross = gram[part, part].copy(), np.delete(gram[part], part, axis=1)
    scale = np.sqrt(np.maximum(np.diag(inner), 1e-300))
    prior = np.zeros(len(inner))

    def solved() -> Array:
        found = np.linalg.lstsq((inner + np.diag(prior)) / scale[:, None] / scale, cross / scale[:, None], rcond=1e-12)[0]
        return np.asarray(found / scale[:, None], dtype=float)

    effects = solved()
    if span > 0.0 and len(inner):
        left = max(float(gram[-1, -1] - cross[:, -1] @ effects[:, -1]), ROUNDING * float(gram[-1, -1])) / max(rows, 1)
        prior[1:extra] = left * alike / (DRIFT * span) ** 2
        shared = inner[0, extra:] ** 2 / max(float(inner[0, 0]), 1e-300) if extra else 0.0
        beside = np.maximum(np.diag(inner)[extra:] - shared, ROUNDING * np.diag(inner)[extra:])
        prior[extra:] = left * beside / (FREE_MOTION * span) ** 2 / max(rows, 1)
        effects = solved()
    return effects, (effects.T * prior) @ effects


def driving_signal(window: Window) -> tuple[Array, int]:
    """Construct the input of a chain whose output is the measurement, row for row.

    Under zoh the measurement at a tick answers the command of the interval before, under foh that of the same instant.
    """
    before = np.zeros(0) if window.memory is None else window.memory
    late = 1 if window.hold == "zoh" else 0
    signal = empty_rows(len(before) + len(window.command))
    first = before if len(before) else window.command
    signal[:late] = first[:late]
    signal[late : len(before) + late] = before
    signal[len(before) + late :] = window.command[: len(window.command) - late]
    return signal.reshape(-1, 1), len(before)


def _step(gram: Array, parametrization: Parametrization, present: Array, origin: Array | float, damping: float) -> Array:
    normal, gradient = gram[:-1, :-1].copy(), gram[:-1, -1].copy()
    diagonal = np.maximum(np.diag(normal), 0.0)
    prior = PRIOR * float(np.max(diagonal))
    normal[np.diag_indices_from(normal)] = (1.0 + damping) * diagonal + prior
    gradient += prior * (origin - present)
    if parametrization.lhs is None or parametrization.rhs is None:
        return constrained_minimum(normal, gradient, np.zeros((0, len(normal))), np.zeros(0))
    return constrained_minimum(normal, gradient, parametrization.lhs, parametrization.rhs - parametrization.lhs @ present)


def constrained_minimum(normal: Array, gradient: Array, lhs: Array, rhs: Array) -> Array:
    """Minimize x' normal x / 2 - gradient' x with lhs x >= rhs.

    Converted to a least distance problem and solved by nonnegative least squares (Lawson & Hanson, Solving Least Squares Problems,
    1974, chapter 23).
    """
    scale = 1.0 / np.sqrt(np.diag(normal))
    normal, gradient, lhs = normal * scale[:, None] * scale, gradient * scale, lhs * scale
    lower = _root(normal + 1e-14 * np.eye(len(normal)))
    free = solve_triangular(lower.T, solve_triangular(lower, gradient, lower=True))
    missing = rhs - lhs @ free
    if not len(missing) or np.all(missing <= 1e-14):
        unbounded: Array = free * scale
        return unbounded
    g = solve_triangular(lower, lhs.T, lower=True).T
    size = np.linalg.norm(g, axis=1)
    g, missing = g / size[:, None], missing / size
    matrix = np.vstack([g.T, missing])
    target = np.append(np.zeros(len(normal)), 1.0)
    weights, _ = nnls(matrix, target, maxiter=50 * matrix.shape[1])
    residual = matrix @ weights - target
    move = -residual[:-1] / residual[-1]
    found: Array = (free + solve_triangular(lower.T, move)) * scale
    return found


def _root(matrix: Array) -> Array:
    """Cholesky root of a matrix that rounding may have left without the last of its positive directions."""
    try:
        return np.asarray(np.linalg.cholesky(matrix), dtype=float)
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(matrix)
        return np.asarray(np.linalg.cholesky((vectors * np.maximum(values, 1e-10 * values[-1])) @ vectors.T), dtype=float)
