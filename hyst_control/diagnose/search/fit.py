# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Fitting a model with candidate effects to records, its scattered coefficients marginalized.

The penalized misfit, all in units of the noise, for coefficients z with prior N(0, 1) and effect parameters x (scaled so that
their broad prior is N(x0, 1) with heavier tails, ρ(a) = ½ c² log(1 + a²/c²), c = `TAIL`: how large an effect is
is known by no more than the order of its size):

    Φ(z, x) = ½ w ‖y - ŷ(z, x)‖² + ½ ‖z‖² + Σ ρ(x - x0)

(w: the problem's weight of a sample, 1 where noise alone separates model and record) is minimized by Gauss-Newton steps whose z-columns
J = ∂ŷ/∂z are those of the nominal model: a scatter of a per cent changes them by a per cent, so a step leaves a per cent of the error, and
only the effect's few columns are renewed. `refined` renews them all. Where parameters are far off that leads astray: a fit of the
coefficients alone has its columns `renewed`, by central differences, as soon as a step reduces Φ by less than they predict.

Beside a large gap such steps lead astray where the effect is the wrong one: the coefficients would have to leave their tolerance many
times over. A fit beside linear coefficients takes ŷ(z, x) = ŷ(0, x) + J z instead, and has the best z for every x.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.base.parallel import known_workers, map_known
from hyst_control.chain.external_simulator import together
from hyst_control.chain.stage import Stage
from hyst_control.diagnose.problem.coefficient_prior import Scatter
from hyst_control.diagnose.problem.problem import Problem

STEP = 0.05  # Difference step for z: a twentieth of a standard deviation
RAN_AWAY = 1e60  # Residual from which a chain is taken to be unstable
TAIL = 3.0  # Size of a parameter, in usual deviations, from which its prior falls more slowly than a normal one

MIN_GAIN = 0.02
"""Misfit (nats) under which a step is not worth taking; a hundred thousandth of the misfit counts as little."""

ROWS_TOGETHER = 2**13  # Rows of many vectors whose products are summed at a time
MIN_APPROACH = 0.25
"""Share of the distance to a better fit under which a step is not worth taking either: such a fit will not reach it."""

LINEAR_FIT_TOLERANCE_FACTOR = 50.0
"""Factor on the least gain of a step beside linear coefficients: they are right to about a per cent, so finer steps say nothing."""

SAFETY = 4.0  # Factor on what is estimated of the misfit that further steps take off
LENGTHS = (1.0, 0.5, 0.25, 0.1)  # Lengths of a step that are tried, in full steps
DAMPED = (1.0, 0.3, 0.1, 0.03, 0.01, 0.003, 0.001)  # The same of a fit whose columns are renewed: its steps are damped to them
KEPT_PROMISE = 0.25  # Least share of the predicted reduction that such a step must achieve: else it is too long for its columns


@dataclass(frozen=True)
class Unknowns:
    """Parameters that are fitted besides z: `stages(z stages, x)` inserts what they mean, `extra(x)` adds to the output.

    x (P,) within lower … upper; centre: the prior's mean; step: of the difference quotients (P,).
    known_columns(x, wanted): which parameters have columns ∂ŷ/∂x (M, P') that are known without a run of the whole chain, and these, at
    least those that are wanted.
    """

    stages: Callable[[tuple[Stage, ...], Array], tuple[Stage, ...]]
    extra: Callable[[Array], Array] | None
    lower: Array
    upper: Array
    centre: Array
    step: Array
    known_columns: Callable[[Array, Collection[int] | None], tuple[list[int], Array]] | None
    again: Callable[[], Unknowns]  # Makes the same unknowns in another process

    def __reduce__(self) -> tuple[object, ...]:
        return self.again, ()

    def difference(self, x: Array, p: int) -> float:
        """Step of the difference quotient by parameter p from x (P,): upwards, but inwards from the upper bound."""
        step = float(self.step[p])
        return step if x[p] + step <= self.upper[p] else -step


@dataclass(frozen=True)
class Solution:
    """End of a fit: misfit Φ, z (K,), x (P,), residual (M,) in units of the noise, and the covariance of (z, x)."""

    misfit: float
    z: Array
    x: Array
    residual: Array
    covariance: Array
    information: Array  # (P, P): of x, z marginalized
    remaining: float = 0.0  # Misfit (nats) that further steps may take off; 0 where the fit has ended


class Linearized:
    """The columns J (M, K) of a model's scattered coefficients on its records, prepared once for all fits."""

    def __init__(
        self,
        problem: Problem,
        scatter: Scatter,
        z: Array | None = None,
        unknowns: Unknowns | None = None,
        x: Array | None = None,
        two_sided: bool = False,
    ) -> None:
        """About the nominal coefficients, or about others, with effects at x where unknowns are given; by differences to both sides."""
        self.problem, self.scatter = problem, scatter
        self.count = len(scatter.coefficients)
        self.measured = problem.measured()
        centre = np.zeros(self.count) if z is None else z
        sides = (STEP, -STEP) if two_sided else (STEP,)
        points = [centre, *(centre + step * moved for step in sides for moved in np.eye(self.count))]
        with together(self._known_chains(points)) as at_once:
            self.nominal = self.simulate(centre, unknowns, x)
            if not is_bounded(self.nominal):
                raise InputError("model: its simulation of the record grows without limit: check its dynamics")
            parts = np.array_split(np.arange(self.count), 1 if at_once else known_workers())
            jobs = [(problem, scatter, self.nominal, centre, part, unknowns, x, two_sided) for part in parts]
            columns = map_known(_columns, jobs)
            self.columns = columns[0] if len(columns) == 1 else np.asfortranarray(np.hstack(columns))
        self.gram = problem.weight * (self.columns.T @ self.columns)
        self.factor = cho_factor(self.gram + np.eye(self.count)) if self.count else None

    def _known_chains(self, points: Sequence[Array]) -> Iterator[tuple[Stage, ...]]:
        """The chains of coefficients (K,), without those that a stage refuses."""
        for point in points:
            with suppress(InputError):
                yield self.scatter.at(point)

    def unexplained(self, vectors: Annotated[Array, "M"]) -> Array:
        """Remove from vectors what the scattered coefficients explain, under their prior."""
        if not self.count:
            return vectors
        explained = self.columns @ cho_solve(self.factor, self.problem.weight * (self.columns.T @ vectors))
        return np.asarray(vectors - explained, dtype=np.float64)

    def unexplained_products(self, *vectors: Annotated[Array, "M P"]) -> Annotated[Array, "P P"]:
        """Inner products between the columns of all vectors and their unexplained parts, without computing these."""
        if len(vectors) == 1:
            (whole,) = vectors
            products, along = whole.T @ whole, self.columns.T @ whole if self.count else None
        else:  # block by block: side by side the vectors would need their memory again
            count = sum(each.shape[1] for each in vectors)
            products, along = np.zeros((count, count)), np.zeros((self.count, count)) if self.count else None
            for begin in range(0, len(vectors[0]), ROWS_TOGETHER):
                rows = slice(begin, begin + ROWS_TOGETHER)
                table = np.hstack([each[rows] for each in vectors])
                products += table.T @ table
                if along is not None:
                    along += self.columns[rows].T @ table
        if along is not None:
            products -= self.problem.weight * (along.T @ cho_solve(self.factor, along))
        return np.asarray(products, dtype=np.float64)

    def companions(self, z: Array) -> Array:
        """The session effects' values of z (K,), the coefficients at the nominal ones."""
        return z * self.scatter.companions if self.count else z

    def simulate(self, z: Annotated[Array, "K"], unknowns: Unknowns | None = None, x: Array | None = None) -> Annotated[Array, "M"]:
        """Simulate all records."""
        return _simulated(self.problem, self.scatter, z, unknowns, x)


def _simulated(problem: Problem, scatter: Scatter, z: Array, unknowns: Unknowns | None, x: Array | None) -> Array:
    try:
        stages = scatter.at(z)
        if unknowns is None:
            return problem.simulate(stages)
        assert x is not None, "unknowns without their values"
        output = problem.simulate(unknowns.stages(stages, x))
        return output if unknowns.extra is None else output + unknowns.extra(x)
    except InputError:
        raise
    except (ArithmeticError, ValueError) as error:  # linear algebra of values beyond all bounds, among others
        raise InputError(f"these values cannot be simulated ({error})") from None


def _columns(
    problem: Problem,
    scatter: Scatter,
    nominal: Array,
    centre: Array,
    wanted: Sequence[int],
    unknowns: Unknowns | None,
    x: Array | None,
    two_sided: bool,
) -> Annotated[Array, "M K'"]:
    """∂ŷ/∂z_k; 0 for a coefficient that can go neither way: a stage may refuse values next to those of the centre, or run away."""
    found = np.zeros((len(nominal), len(wanted)), order="F")  # a column's values side by side: it is faster
    for place, k in enumerate(wanted):
        sides = list[Array]()
        for step in (STEP, -STEP):
            moved = centre.copy()
            moved[k] += step
            try:
                with np.errstate(over="ignore", invalid="ignore"):  # far from the model it may run away
                    column = (_simulated(problem, scatter, moved, unknowns, x) - nominal) / step
            except InputError:
                continue
            if is_bounded(column):
                sides.append(column)
                if not two_sided:
                    break
        if sides:
            found[:, place] = sum(sides) / len(sides)
    return found


def fit(
    linearized: Linearized,
    unknowns: Unknowns | None = None,
    start: Array | None = None,
    z: Array | None = None,
    rounds: int = 8,
    measured: Array | None = None,
    weight: Array | None = None,
    rival: float = np.inf,
    linear: bool = False,
    renewed: bool = False,
) -> Solution:
    """Minimize Φ over z and x by damped Gauss-Newton steps."""
    # renewed: whether the caller renews the columns where the fit ends: it ends with the first step that they are too old for
    # linear: whether ŷ(z, x) is taken as ŷ(0, x) + J z, whose best z is known for every x. The chain is run with the coefficients
    # that it has, so that a run costs less, and none of their steps leads astray. Φ and residual of the solution are those of this
    # output
    y = linearized.measured if measured is None else measured
    x = np.zeros(0)
    if start is not None and len(start):
        assert unknowns is not None, "a start without unknowns"
        x = np.clip(start, unknowns.lower, unknowns.upper)
    z = np.zeros(linearized.count) if z is None else z
    count, size = linearized.count, len(x)
    fitted = unknowns if size else None
    columns, gram, sample_weight = linearized.columns, linearized.gram, linearized.problem.weight
    if weight is not None:
        columns = columns * weight[:, None]
        gram = sample_weight * (columns.T @ columns)

    nominal = np.zeros(count)

    def tried(z: Array, x: Array) -> tuple[float, Array, Array, Array]:
        """Φ, the z that it belongs to, the residual (beside linear coefficients: before z takes its part off), and the simulated output."""
        output = linearized.simulate(nominal if linear else z, unknowns, x)
        found = y - output
        # chosen, not multiplied: 0 times what ran away to infinity is no number
        found = found if weight is None else np.where(weight > 0, found, 0.0)
        if not is_bounded(found):
            return np.inf, z, found, output
        energy = sample_weight * float(found @ found)
        if linear and count:
            along = sample_weight * (columns.T @ found)
            z = np.asarray(cho_solve(linearized.factor, along), dtype=np.float64)
            energy -= float(along @ z)
        elif not linear:
            energy += float(z @ z)
        return 0.5 * energy + _prior_misfit(x if fitted is None else x - fitted.centre), z, found, output

    def least_gain(misfit: float) -> float:
        """Misfit that a step has to take off."""
        finest = (LINEAR_FIT_TOLERANCE_FACTOR if linear else 1.0) * (MIN_GAIN + 1e-5 * misfit)
        return max(finest, MIN_APPROACH * (misfit - rival))

    misfit, z, residual, output = tried(z, x)
    normal = np.eye(count + size)
    remaining = 0.0
    for _ in range(rounds):
        remaining = 0.0
        enough = least_gain(misfit)
        if fitted is None:
            design, away = np.zeros((len(y), 0)), x
        else:
            try:
                design = effect_columns(linearized, fitted, nominal if linear else z, x, output, weight)
                away = x - fitted.centre
            except InputError:
                break  # next to these values the chain cannot be simulated
        normal = _normal(columns, gram, design, away, sample_weight)
        if linear:  # the best z for x leaves nothing that a step of z alone would take off
            pull, left = np.zeros(count), sample_weight * (design.T @ residual) - normal[count:, :count] @ z
        else:
            pull, left = sample_weight * (columns.T @ residual) - z, sample_weight * (design.T @ residual)
        right = np.concatenate([pull, left - _prior_weight(away) * away])
        step = np.asarray(np.linalg.solve(normal, right), dtype=np.float64)
        if fitted is not None:
            step = _within(normal, right, step, x, fitted, count)
        promise = float(right @ step - 0.5 * step @ normal @ step)
        if promise < enough:
            break  # a linear step would gain next to nothing
        better = False
        for shorter in DAMPED if renewed else LENGTHS:
            part = _damped(normal, right, shorter * float(np.linalg.norm(step))) if renewed and shorter < 1.0 else shorter * step
            promised = float(right @ part - 0.5 * part @ normal @ part)
            if promised < enough:
                break
            new_z, new_x = z + part[:count], x + part[count:]
            if fitted is not None:
                new_x = np.clip(new_x, fitted.lower, fitted.upper)
            try:
                new, new_z, new_residual, new_output = tried(new_z, new_x)
            except InputError:
                continue
            if np.isfinite(new) and misfit - new > (KEPT_PROMISE * promised if renewed else 0.0):
                better = True
                break
        if not better:
            break
        gained = misfit - new
        z, x, residual, output, misfit = new_z, new_x, new_residual, new_output, new
        if renewed and gained < 0.75 * promise:
            break
        remaining = SAFETY * promise
        if linear and fitted is not None and shorter == LENGTHS[0]:
            # Of a quadratic misfit a full step leaves neither a slope nor a difference between what it promised and what it gained.
            away = x - fitted.centre
            slope = sample_weight * (design.T @ residual) - normal[count:, :count] @ z - _prior_weight(away) * away
            right = np.concatenate([np.zeros(count), slope])
            ahead = 0.5 * float(right @ np.linalg.solve(normal, right))
            remaining = SAFETY * ahead + (SAFETY * (promise - gained)) ** 2 / promise
        if min(gained, remaining) < least_gain(misfit):
            remaining = 0.0
            break
    if linear and is_bounded(residual):
        residual = residual - columns @ z
    covariance = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    information = np.zeros((0, 0))
    if fitted is not None:
        # Of the parameters' evidence the prior's part is that of its middle: 1.
        beyond = 1.0 - _prior_weight(x - fitted.centre)
        information = np.asarray(np.linalg.inv(covariance[count:, count:]), dtype=np.float64) + np.diag(beyond)
    return Solution(misfit, z, x, residual, covariance, information, remaining)


def _damped(normal: Annotated[Array, "P P"], right: Annotated[Array, "P"], length: float) -> Array:
    """The step of a given length that reduces Φ most: shorter mainly in weakly determined directions (Levenberg, 1944)."""
    sizes, directions = np.linalg.eigh(normal)
    along = directions.T @ right
    damping = sizes[0] * 2.0 ** np.arange(64)
    lengths = np.linalg.norm(along / (sizes + damping[:, None]), axis=1)
    return np.asarray(directions @ (along / (sizes + damping[np.argmin(np.abs(lengths - length))])), dtype=np.float64)


def effect_columns(
    linearized: Linearized,
    unknowns: Unknowns,
    z: Annotated[Array, "K"],
    x: Annotated[Array, "P"],
    base: Annotated[Array, "M"],
    weight: Array | None = None,
    chosen: Sequence[int] | None = None,
) -> Annotated[Array, "M P'"]:
    """Derivatives ∂ŷ/∂x of the effects' parameters: known ones, else difference quotients, taken inwards at a bound."""
    chosen = range(len(x)) if chosen is None else chosen
    found = np.zeros((len(base), len(chosen)))
    place = {p: column for column, p in enumerate(chosen)}
    known: list[int] = []
    if unknowns.known_columns is not None:
        known, columns = unknowns.known_columns(x, place)
        inside = [i for i, p in enumerate(known) if p in place]
        if inside:
            found[:, [place[known[i]] for i in inside]] = columns if len(inside) == len(known) else columns[:, inside]
    counted = slice(None) if weight is None else weight > 0
    for p in [p for p in chosen if p not in known]:
        step = unknowns.difference(x, p)
        moved = x.copy()
        moved[p] += step
        column = ((linearized.simulate(z, unknowns, moved) - base) / step)[counted]
        if not is_bounded(column):
            raise InputError("the chain grows without limit next to these values")
        found[counted, place[p]] = column
    return found if weight is None else found * weight[:, None]


def is_bounded(values: Array) -> bool:
    """False for what an unstable chain gives."""
    return bool(np.max(np.abs(values), initial=0.0) < RAN_AWAY)


def _normal(columns: Array, gram: Array, design: Array, away: Array, weight: float) -> Array:
    count, size = columns.shape[1], design.shape[1]
    normal = np.empty((count + size, count + size))
    cross = weight * (columns.T @ design)
    normal[:count, :count], normal[:count, count:], normal[count:, :count] = gram, cross, cross.T
    normal[count:, count:] = weight * (design.T @ design)
    normal[np.diag_indices(count + size)] += np.concatenate([np.ones(count), _prior_weight(away)])
    return normal


def _prior_misfit(away: Array) -> float:
    """Misfit Σ ρ of parameters (P,) that are so far from the prior's middle."""
    return 0.5 * TAIL**2 * float(np.sum(np.log1p((away / TAIL) ** 2)))


def _prior_weight(away: Array) -> Array:
    """Weights (P,) with which squares have the prior's slope there."""
    return np.asarray(1.0 / (1.0 + (away / TAIL) ** 2), dtype=np.float64)


def _within(normal: Array, right: Array, step: Array, x: Array, unknowns: Unknowns, count: int) -> Array:
    """The step with parameters that would leave their bounds held there."""
    target = x + step[count:]
    out = np.flatnonzero((target < unknowns.lower) | (target > unknowns.upper))
    if not len(out):
        return step
    held = np.clip(target[out], unknowns.lower[out], unknowns.upper[out]) - x[out]
    free = np.setdiff1d(np.arange(len(step)), count + out)
    fresh = np.empty_like(step)
    fresh[count + out] = held
    fresh[free] = np.linalg.solve(normal[np.ix_(free, free)], right[free] - normal[np.ix_(free, count + out)] @ held)
    return fresh


def refined(
    linearized: Linearized,
    unknowns: Unknowns | None,
    solution: Solution,
    rounds: int = 4,
    rival: float = np.inf,
    renewed: bool = False,
) -> Solution:
    """Continue a fit with columns taken at its end, until that gains nothing more or brings it no nearer to a better one."""
    for _ in range(rounds):
        try:
            here = Linearized(linearized.problem, linearized.scatter, solution.z, unknowns, solution.x, renewed)
            again = fit(here, unknowns, solution.x, solution.z, rival=rival, renewed=renewed)
        except InputError:
            break
        gained = solution.misfit - again.misfit
        if gained < 0:
            break
        solution = again
        if gained < max(0.5, MIN_APPROACH * (solution.misfit - rival)):
            break
    return solution
