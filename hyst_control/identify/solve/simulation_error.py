"""Least squares on the simulation error of any chain, with linear inequality constraints on its parameters.

The chain itself is run, so the fit is to the output of the model file. Derivatives are differences between chains of
neighboring parameters, streamed side by side over the records block by block; the data for a step are kept as Gram matrices.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.optimize import nnls

from hyst_control.chain import Sampling, Stage
from hyst_control.chain.stage import Array
from hyst_control.identify.data.reversal_points import turning_points
from hyst_control.identify.solve import gauss_newton
from hyst_control.identify.solve.bounded_least_squares import covariance
from hyst_control.identify.solve.chain_batch import Bundle
from hyst_control.identify.solve.gauss_newton import End, Rules, Trial
from hyst_control.identify.solve.gram_sums import HELD_OUT_BLOCKS, MOST_BLOCKS, NUISANCES, Grams, Window, gram_product
from hyst_control.records.row_store import blocks as row_blocks
from hyst_control.records.row_store import empty_rows

BLOCK, CHUNK = 4096, 32768
"""Largest number of rows of one block's Gram matrix, and rows simulated at a time."""
STEP = 1e-5
"""Difference of neighboring parameters, which are all of order one."""
PRIOR = 1e-10
"""Weight of the prior on every parameter relative to the strongest one: determines only directions that the data do not show at all."""


@dataclass(frozen=True)
class Parametrization:
    """Chain of a parameter vector (P,) of order one, and the constraints lhs · parameters >= rhs.

    Parameters
    ----------
    stages
        Chain of a parameter vector.
    lhs
        Left sides (C, P) of the constraints.
    rhs
        Right sides (C,).
    limit
        Nearest admissible vector to a vector, for bounds that are not linear.
    """

    stages: Callable[[Array], Sequence[Stage]]
    lhs: Array
    rhs: Array
    limit: Callable[[Array], Array] = staticmethod(lambda vector: vector)


@dataclass(frozen=True)
class Solution:
    """Solution of a simulation-error fit.

    Parameters
    ----------
    parameters
        Parameters (P,).
    nuisances
        Nuisances of the records.
    fitted, held_out
        Mean square errors on the rows fitted and held out.
    grams
        Gram matrices of [derivatives, nuisances, error].
    passes
        Number of passes over the records.
    linearized
        Parameters (P,) at which the derivatives in `grams` were taken: these, or those one step before.
    """

    parameters: Array
    nuisances: Array
    fitted: float
    held_out: float
    grams: Grams
    passes: int
    linearized: Array

    @property
    def covariance(self) -> Array:
        """Covariance (P, P) of the parameters, errors of the model included."""
        size = len(self.parameters)
        return covariance(self.grams.blocks, np.concatenate([self.parameters - self.linearized, self.nuisances]))[:size, :size]


def minimize_simulation_error(
    windows: Sequence[Window],
    parametrization: Parametrization,
    start: Array,
    *,
    nuisance: str = "linear",
    passes: int = 12,
    tolerance: float = 1e-4,
    everything: bool = False,
) -> Solution:
    """Fit a chain's parameters to records by damped Gauss-Newton. Never worse than the start.

    A pass with derivatives is done at every parameter vector that lowered the cost, but for the last; whether one does is tried by a
    pass without.

    Parameters
    ----------
    windows
        Stretches of the records of one axis.
    parametrization
        Chain and constraints of a parameter vector.
    start
        Parameters (P,) to begin with, which satisfy the constraints.
    nuisance
        Addition of each record: "none", "offset" or "linear".
    passes
        Most passes with derivatives, the first one included.
    tolerance
        Share of the cost that a step must gain for the search to go on.
    everything
        Fit also the rows held out for choosing between structures.

    Returns
    -------
    Solution
        Parameters, nuisances, errors, and the Gram matrices that the covariance comes from.
    """
    origin = parametrization.limit(np.asarray(start, dtype=float))
    search = _Search(windows, parametrization, origin, nuisance, everything)
    rules = Rules(
        damping=1e-3,
        raised=lambda damping: damping * 10.0,
        eased=lambda damping: max(0.1 * damping, 1e-9),
        small=lambda before, after: 1.0 - after / before < tolerance,
        confident=1e-6,
        steps=passes - 1,
        highest=1e4,
        least_move=1e-8,
    )
    found = gauss_newton.minimize(search, search.start(), rules)
    solution = found.point if found.linearized or found.end is End.BUDGET else search.linearize(found.point)
    return replace(solution, passes=found.steps + 1)


@dataclass(frozen=True)
class _Search:
    """The least-squares problem of `minimize_simulation_error`; a point is a `Solution`, whose Gram matrices hold the derivatives."""

    windows: Sequence[Window]
    parametrization: Parametrization
    origin: Array
    nuisance: str
    everything: bool

    def grams(self, parameters: Array, *, derivatives: bool) -> Grams:
        groups = max(window.group for window in self.windows) + 1
        return gram_matrices(self.windows, self.parametrization, parameters, self.nuisance, groups, derivatives=derivatives)

    def start(self) -> Solution:
        return _solution(self.origin, self.grams(self.origin, derivatives=True), self.everything, 1, derivatives=True)

    def cost(self, point: Solution) -> float:
        return point.fitted

    def linearize(self, point: Solution) -> Solution:
        return replace(point, grams=self.grams(point.parameters, derivatives=True), linearized=point.parameters)

    def step(self, point: Solution, damping: float) -> Trial[Solution]:
        grams = point.grams
        gram = grams.fitted + grams.held_out if self.everything else grams.fitted
        step = _step(gram, self.parametrization, point.parameters, self.origin, damping)
        # Shortened as a whole, so that it stays between two vectors that satisfy the constraints.
        step /= max(1.0, float(np.max(np.abs(step))))
        parameters = self.parametrization.limit(point.parameters + step)
        found = _solution(parameters, self.grams(parameters, derivatives=False), self.everything, point.passes, derivatives=False)
        return Trial(replace(found, grams=grams, linearized=point.parameters), float(np.max(np.abs(step))))


def simulation_error(windows: Sequence[Window], parametrization: Parametrization, parameters: Array, nuisance: str) -> float:
    """Mean square of the simulation error over all rows, beside the nuisances that reduce it most.

    Parameters
    ----------
    windows
        Stretches of the records of one axis.
    parametrization
        Chain of a parameter vector.
    parameters
        Parameters (P,).
    nuisance
        Nuisance of each record.

    Returns
    -------
    float
        Square of the measurement's unit.
    """
    groups = max(window.group for window in windows) + 1
    grams = gram_matrices(windows, parametrization, parameters, nuisance, groups, derivatives=False)
    return _solution(parameters, grams, True, 1, derivatives=False).fitted


def gram_matrices(
    windows: Sequence[Window], parametrization: Parametrization, parameters: Array, nuisance: str, groups: int, *, derivatives: bool
) -> Grams:
    """Form the Gram matrices of [derivatives (P), nuisances per record, error]; every third block is held out.

    Parameters
    ----------
    windows
        Stretches of the records.
    parametrization
        Chain of a parameter vector.
    parameters
        Parameters (P,).
    nuisance
        Nuisance of each record, one of `NUISANCES`.
    groups
        Number of records.
    derivatives
        Include the derivatives.

    Returns
    -------
    Grams
        Gram matrices of the rows fitted and held out.
    """
    size, extra = len(parameters) * derivatives, NUISANCES[nuisance]
    total = size + extra * groups + 1
    grams, rows = np.zeros((2, total, total)), [0, 0]
    blocks: list[Array] = []
    vectors = [parameters, *(parameters + STEP * unit for unit in np.eye(len(parameters))[:size])]
    chains = [tuple(parametrization.stages(vector)) for vector in vectors]
    clocks: dict[Sampling, Bundle] = {}
    everything = sum(len(window.command) for window in windows)
    length = int(np.clip(everything // HELD_OUT_BLOCKS, 1, BLOCK))
    together, count = -(-everything // (length * MOST_BLOCKS)), 0
    for window in windows:
        place = np.r_[0:size, size + window.group * extra + np.arange(extra), total - 1]
        square = np.ix_(place, place)
        sampling = Sampling(window.sample_time, 1, window.hold)
        if sampling not in clocks:
            clocks[sampling] = Bundle(chains, sampling)
        running = clocks[sampling]
        signal, first = driving_signal(window)
        running.settle(float(signal[0, 0]))
        for earlier in row_blocks(first):
            running.process(signal[earlier])
        n = len(window.command)
        for chunk in range(0, n, CHUNK):
            stop = min(chunk + CHUNK, n)
            part = signal[first + chunk : first + stop]
            columns = np.empty((stop - chunk, size + extra + 1), order="F")
            nominal, *neighbours = running.process(part)
            for i, neighbour in enumerate(neighbours):
                np.subtract(neighbour, nominal, out=columns[:, i])
            columns[:, :size] /= STEP
            share = window.begin + window.share * np.arange(chunk, stop) / n
            for power in range(extra):
                columns[:, size + power] = (share - 0.5) ** power
            np.subtract(window.measurement[chunk:stop], nominal, out=columns[:, -1])
            for begin in range(max(window.skip - chunk, 0), stop - chunk, length):
                block = columns[begin : begin + length]
                product = np.zeros((total, total))
                product[square] = gram_product(np.ascontiguousarray(block))
                if count % together:
                    blocks[-1] += product
                else:
                    blocks.append(product)
                count += 1
                which = 1 if count % 3 == 0 else 0
                grams[which] += product
                rows[which] += len(block)
    return Grams(grams[0], grams[1], (rows[0], rows[1]), np.array(blocks))


def driving_signal(window: Window) -> tuple[Array, int]:
    """Construct the input of a chain whose output is the measurement, row for row.

    Under zoh the measurement at a tick answers the command of the interval before, under foh that of the same instant.

    Parameters
    ----------
    window
        A stretch of a record.

    Returns
    -------
    signal : Array
        Input (M, 1), the memory first.
    first : int
        Row at which the window begins.
    """
    before = np.zeros(0) if window.memory is None else window.memory
    late = 1 if window.hold == "zoh" else 0
    signal = empty_rows(len(before) + len(window.command))
    first = before if len(before) else window.command
    signal[:late] = first[:late]
    signal[late : len(before) + late] = before
    signal[len(before) + late :] = window.command[: len(window.command) - late]
    return signal.reshape(-1, 1), len(before)


def _solution(parameters: Array, grams: Grams, everything: bool, passes: int, *, derivatives: bool) -> Solution:
    """Nuisances that reduce the error most, and the remaining mean squares."""
    first = len(parameters) if derivatives else 0
    chosen = grams.fitted + grams.held_out if everything else grams.fitted
    inner = chosen[first:-1, first:-1]
    nuisances: Array = np.zeros(0)
    if len(inner):
        nuisances = np.asarray(np.linalg.lstsq(inner, chosen[first:-1, -1], rcond=1e-12)[0], dtype=float)
    vector = np.append(nuisances, -1.0)

    def mean_square(gram: Array, rows: int) -> float:
        return max(float(vector @ gram[first:, first:] @ vector), 0.0) / max(rows, 1)

    rows = sum(grams.rows) if everything else grams.rows[0]
    held_out = mean_square(grams.held_out, grams.rows[1])
    return Solution(parameters, nuisances, mean_square(chosen, rows), held_out, grams, passes, parameters)


def _step(gram: Array, parametrization: Parametrization, present: Array, origin: Array, damping: float) -> Array:
    size = len(present)
    normal, gradient = gram[:-1, :-1].copy(), gram[:-1, -1].copy()
    diagonal = np.diag(normal).copy()
    strongest = float(np.max(diagonal[:size]))
    index = np.arange(size)
    normal[index, index] += damping * diagonal[:size] + PRIOR * strongest
    gradient[:size] += PRIOR * strongest * (origin - present)
    others = np.arange(size, len(normal))
    normal[others, others] += 1e-12 * diagonal[others] + 1e-300
    lhs = np.zeros((len(parametrization.lhs), len(normal)))
    lhs[:, :size] = parametrization.lhs
    return constrained_minimum(normal, gradient, lhs, parametrization.rhs - parametrization.lhs @ present)[:size]


def constrained_minimum(normal: Array, gradient: Array, lhs: Array, rhs: Array) -> Array:
    """Minimize x' normal x / 2 - gradient' x with lhs x >= rhs.

    Converted to a least distance problem and solved by nonnegative least squares (Lawson & Hanson, Solving Least Squares Problems,
    1974, chapter 23).

    Parameters
    ----------
    normal
        Positive definite matrix (K, K).
    gradient
        Vector (K,).
    lhs
        Left sides (C, K) of the constraints.
    rhs
        Right sides (C,).

    Returns
    -------
    Array
        The minimum x (K,).
    """
    scale = 1.0 / np.sqrt(np.diag(normal))
    normal, gradient, lhs = normal * scale[:, None] * scale, gradient * scale, lhs * scale
    lower = np.linalg.cholesky(normal + 1e-14 * np.eye(len(normal)))
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


@njit(cache=True)
def surviving_turns(values: Array) -> NDArray[np.int64]:
    """Find the turning points that no later excursion has passed: Madelung's rules remember no others.

    Parameters
    ----------
    values
        Signal (N,).

    Returns
    -------
    NDArray[np.int64]
        Indices of the turning points.
    """
    kept = np.empty(values.size, dtype=np.int64)
    count = 0
    for k in range(values.size):
        if count >= 2 and (values[k] - values[kept[count - 1]]) * (values[kept[count - 1]] - values[kept[count - 2]]) >= 0.0:
            count -= 1
        kept[count] = k
        count += 1
        # The pair before the last point is wiped out when the last one lies past its beginning.
        while count >= 4 and (values[k] - values[kept[count - 3]]) * (values[k] - values[kept[count - 2]]) >= 0.0:
            count -= 2
            kept[count - 1] = k
    return kept[:count]


def thinned(window: Window) -> Window:
    """Thin a window whose command creeps to every n-th row, between which its motion is straight.

    A held command is, at the coarse sample time, the mean of the values before and after the tick.

    Parameters
    ----------
    window
        A stretch of a record.

    Returns
    -------
    Window
        The thinned window, or the window itself.
    """
    steps = np.abs(np.diff(window.command))
    largest = float(steps.max()) if len(steps) else 0.0
    factor = int(0.01 * float(np.ptp(window.command)) / largest) if largest > 0 else 1
    if factor < 4 or window.memory is not None:
        return window
    command = window.command
    if window.hold == "zoh":
        command = 0.5 * (np.append(command[:1], command[:-1]) + command)
    return replace(
        window,
        command=np.ascontiguousarray(command[::factor]),
        measurement=np.ascontiguousarray(window.measurement[::factor]),
        sample_time=window.sample_time * factor,
        hold="foh",
        skip=-(-window.skip // factor),
    )


def short_stretches(windows: Sequence[Window], rows: int, length: float, settle: float) -> list[Window]:
    """Choose short stretches that are spread evenly over the windows.

    Creeping records stay whole, but coarser (`thinned`). A stretch includes the turning points before it that still matter.

    Parameters
    ----------
    windows
        The records.
    rows
        Approximate number of rows to choose.
    length
        Length of a stretch, s.
    settle
        Time at the begin of a stretch, the transients, that does not count, s.

    Returns
    -------
    list[Window]
        The stretches; the windows themselves if they have no more rows than that.
    """
    if sum(len(window.command) for window in windows) <= rows:
        return list(windows)
    whole = [(window, thinned(window)) for window in windows]
    chosen = [thin for window, thin in whole if thin is not window]
    quick = [window for window, thin in whole if thin is window]
    rows -= sum(len(window.command) for window in chosen)
    total = sum(len(window.command) for window in quick)
    for window in quick:
        n = len(window.command)
        size = min(int(length / window.sample_time), n)
        count = max(int(round(n * max(rows, total // 50) / total / size)), 3)
        if count * size >= n:
            chosen.append(window)
            continue
        turns = turning_points(window.command)
        remembered = np.zeros(1) if window.memory is None else window.memory[turning_points(window.memory)]
        for begin in np.unique(np.linspace(0, n - size, count).astype(int)):
            end = begin + size
            earlier = np.concatenate([remembered, window.command[turns[turns < begin]]]) if begin else None
            memory = window.memory if earlier is None else earlier[surviving_turns(earlier)]
            skip = min(max(int(settle / window.sample_time) if begin else 0, window.skip - begin), size - 1)
            part = slice(begin, end)
            chosen.append(
                Window(
                    window.command[part],
                    window.measurement[part],
                    window.sample_time,
                    window.hold,
                    skip,
                    window.group,
                    window.begin + window.share * begin / n,
                    window.share * size / n,
                    memory,
                )
            )
    return chosen
