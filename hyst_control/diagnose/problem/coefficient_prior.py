# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The scatter of a nominal model: which of its coefficients are uncertain, by how much, and the model for other values of them.

Uncertain coefficients are nuisance parameters z with prior N(0, 1). Where the model file has `uncertainty`, values = nominal +
factor · z, in frequencies, dampings and gains (`chain.coordinates`). Else each coefficient that its `tolerance` names scatters by
itself: value = nominal · (1 + tolerance · z), as its stage declares it (`chain.parameter`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.chain import Stage
from hyst_control.chain.bounded_cache import KEPT
from hyst_control.chain.coordinates import chain_coordinates, with_coordinates
from hyst_control.chain.parameter import Scattering
from hyst_control.diagnose.problem.problem import Problem
from hyst_control.model_file import Model

LARGEST = 0.3
"""Largest relative deviation (1 sigma) of a coefficient beside the model discrepancy: a direction that the data cannot tell."""
LEAST_MOVE = 0.3
"""Norm by which a standard deviation of coefficients moves a record, in units of noise and discrepancy, to count: 0.05 nats."""
DIFFERENCE = 1e-4  # Relative change of a coefficient from which its slope is read


@dataclass(frozen=True)
class Coefficient:
    """One uncertain number: the stage it is in (indices from the chain down through branches), its field and index in it.

    tolerance: relative, 1 sigma; of a companion, which is free about 0 in every hypothesis, absolute; of a column of the uncertainty's
    factor, which has no path and is called by the number that it moves most, a factor of the column.
    """

    path: tuple[int, ...]
    field: str
    index: tuple[int, ...]
    axis: int | None
    tolerance: float
    name: str
    companion: bool = False


@dataclass(frozen=True)
class Scatter:
    """The uncertain coefficients of a model, whose shared parameters are spread over its axes."""

    model: Model
    coefficients: tuple[Coefficient, ...]
    joint: Joint | None = None  # Numbers that scatter together, by the first coefficients; None where each scatters by itself
    _known: dict[bytes, tuple[Stage, ...]] = field(default_factory=dict, init=False, compare=False, repr=False)
    _made: dict[object, Stage] = field(default_factory=dict, init=False, compare=False, repr=False)
    """Stages by other values: where one coefficient moves, the other stages are those of the chain before."""

    def __reduce__(self) -> tuple[object, ...]:
        return Scatter, (self.model, self.coefficients, self.joint)

    @property
    def companions(self) -> Array:
        """1 for every session effect among the coefficients, else 0; (K,)."""
        return np.array([float(coefficient.companion) for coefficient in self.coefficients])

    def size(self, coefficient: Coefficient) -> float:
        """Size of a session effect whose nuisance value is 1."""
        return coefficient.tolerance * stage_at(self.model.chain.stages, coefficient.path).companion_size(coefficient.index)

    def at(self, z: Array) -> tuple[Stage, ...]:
        """The stages for nuisance values z (K,)."""
        key = z.tobytes()
        if key not in self._known:
            if len(self._known) >= KEPT:
                self._known.clear()
            self._known[key] = self._stages(z)
        return self._known[key]

    def _stages(self, z: Array) -> tuple[Stage, ...]:
        stages = self.model.chain.stages
        if self.joint is not None:
            columns = self.joint.factor.shape[1]
            sizes = np.array([coefficient.tolerance for coefficient in self.coefficients[:columns]])
            if np.any(z[:columns]):
                moved = self.joint.values + self.joint.factor @ (sizes * z[:columns])
                stages = with_coordinates(stages, dict(zip(self.joint.names, moved.tolist(), strict=True)), self.model.axes)
        changes: dict[tuple[int, ...], dict[str, Array]] = {}
        for coefficient, value in zip(self.coefficients, z, strict=True):
            if value and coefficient.path:
                stage = stage_at(stages, coefficient.path)
                changed = changes.setdefault(coefficient.path, {})
                if coefficient.field not in changed:
                    changed[coefficient.field] = np.array(getattr(stage, coefficient.field), dtype=float)
                if coefficient.companion:
                    changed[coefficient.field][coefficient.index] += coefficient.tolerance * value
                else:
                    changed[coefficient.field][coefficient.index] *= 1.0 + coefficient.tolerance * value
        return tuple(self._changed(stage, (i,), changes) for i, stage in enumerate(stages))

    def _changed(self, stage: Stage, path: tuple[int, ...], changes: Mapping[tuple[int, ...], Mapping[str, Array]]) -> Stage:
        if stage.inner_chains:
            return stage.with_inner_chains(
                [
                    [self._changed(member, (*path, b, m), changes) for m, member in enumerate(chain)]
                    for b, chain in enumerate(stage.inner_chains)
                ]
            )
        if path not in changes:
            return stage
        if self.joint is not None:  # the stage itself is another one for every z
            return stage.with_values(changes[path])
        key = path, *((name, values.tobytes()) for name, values in changes[path].items())
        if key not in self._made:
            if len(self._made) >= KEPT:
                self._made.clear()
            self._made[key] = stage.with_values(changes[path])
        return self._made[key]


@dataclass(frozen=True)
class Joint:
    """Numbers of a chain that scatter together: values = nominal + factor @ z.

    names: of the P numbers, as in `chain.coordinates`; values: their nominal ones (P,); factor: (P, K), a column per coefficient.
    """

    names: tuple[str, ...]
    values: Array
    factor: Array


def scatter_of(model: Model) -> Scatter:
    """The coefficients of the model's uncertainty; without one, those that its tolerance names by parameter or `stage.parameter`.

    Coefficients that are zero have no tolerance.
    """
    if model.uncertainty:
        joint = _joint(model)
        companions = scatter_of(replace(model, uncertainty={}, tolerance={}))
        return Scatter(companions.model, (*_columns(joint), *companions.coefficients), joint)
    axes = len(model.axes)
    spread = tuple(_spread(stage, model.tolerance, axes) for stage in model.chain.stages)
    found: list[Coefficient] = []
    for i, stage in enumerate(spread):
        found += _coefficients(stage, (i,), model.tolerance, model.axes)
    return Scatter(model.with_stages(spread), tuple(found))


def _joint(model: Model) -> Joint:
    names, factor = tuple(model.uncertainty["parameters"]), np.array(model.uncertainty["factor"], dtype=float)
    known = chain_coordinates(model.chain.stages, model.axes)
    used = np.flatnonzero(np.any(factor, axis=0))
    return Joint(names, np.array([known[name].value for name in names]), factor[:, used])


def _columns(joint: Joint) -> tuple[Coefficient, ...]:
    """Columns of the factor, each called by a number of its own that it moves more than other columns do, as far as there are so many."""
    sizes = np.linalg.norm(joint.factor, axis=1)
    share = np.abs(joint.factor) / np.where(sizes > 0.0, sizes, np.inf)[:, None]
    numbers = np.argmax(share, axis=0)
    from scipy.optimize import linear_sum_assignment  # takes long to import

    own, columns = linear_sum_assignment(share, maximize=True)
    numbers[columns] = own
    return tuple(Coefficient((), "", (), None, 1.0, joint.names[number].partition(".")[2]) for number in numbers)


def within_own_error(scatter: Scatter, problem: Problem) -> Scatter:
    """Limit every tolerance to a physical size: what moves the output by as much as the model discrepancy, and `LARGEST` at most."""
    # problem: records, and the model discrepancy; without it, or where the coefficients scatter together, as a fit has found it,
    # the scatter is returned unchanged
    if problem.own_error is None or scatter.joint is not None:
        return scatter
    size = float(np.sqrt(np.mean((problem.own_error / problem.sigma) ** 2)))
    nominal = problem.simulate(scatter.model.chain.stages)
    limited = []
    for coefficient in scatter.coefficients:
        if not coefficient.companion:
            alone = Scatter(scatter.model, (replace(coefficient, tolerance=DIFFERENCE),))
            try:
                slope = float(np.sqrt(np.mean((problem.simulate(alone.at(np.ones(1))) - nominal) ** 2))) / DIFFERENCE
            except InputError:
                slope = 0.0  # at the edge of what makes a model
            largest = min(LARGEST, size / slope) if np.isfinite(slope) and slope > 0 else LARGEST
            coefficient = replace(coefficient, tolerance=min(coefficient.tolerance, largest))
        limited.append(coefficient)
    return Scatter(scatter.model, tuple(limited))


def reduced(scatter: Scatter, moves: Annotated[Array, "M K"]) -> Scatter:
    """The directions of coefficients that scatter together in which they move the records."""
    # moves: of the coefficients on the records, in units of noise and discrepancy
    if scatter.joint is None:
        return scatter
    own = moves[:, : scatter.joint.factor.shape[1]]
    values, vectors = np.linalg.eigh(own.T @ own)
    seen = values > LEAST_MOVE**2
    if seen.all():
        return scatter
    joint = replace(scatter.joint, factor=scatter.joint.factor @ vectors[:, seen])
    return Scatter(scatter.model, (*_columns(joint), *scatter.coefficients[own.shape[1] :]), joint)


def pinned(scatter: Scatter, moves: Annotated[Array, "M K"]) -> Scatter:
    """Narrow coefficients that scatter together to what baseline records allow."""
    # moves: of the coefficients on the baseline records, in units of that discrepancy
    if scatter.joint is None:
        return scatter
    own = moves[:, : scatter.joint.factor.shape[1]]
    values, vectors = np.linalg.eigh(own.T @ own)
    narrow = (vectors / np.sqrt(1.0 + np.maximum(values, 0.0))) @ vectors.T
    joint = replace(scatter.joint, factor=scatter.joint.factor @ narrow)
    return Scatter(scatter.model, (*_columns(joint), *scatter.coefficients[own.shape[1] :]), joint)


def _named(stage: Stage, tolerance: Mapping[str, float]) -> dict[str, float]:
    """Tolerance by parameter of a stage, of those that scatter."""
    found = {}
    for name, declaration in stage.declarations().items():
        if declaration.scatter is Scattering.COMPANION:
            found[name] = 1.0
            continue
        value = tolerance.get(f"{stage.name}.{name}", tolerance.get(name))
        if value and declaration.scatter is not Scattering.NONE and getattr(stage, name) is not None:
            found[name] = float(np.max(value))
    return found


def idle_tolerances(model: Model) -> list[str]:
    """Names under `tolerance` of a model file by which no parameter of its chain scatters: misspelled, or of another model."""
    known = {name for stage in model.chain.stages for name in names_that_scatter(stage)}
    return [name for name, share in model.tolerance.items() if np.any(share) and name not in known]


def names_that_scatter(stage: Stage) -> set[str]:
    """Names that a tolerance can have of a stage and of those within it: of a parameter, or `stage.parameter`."""
    inner = {name for chain in stage.inner_chains for member in chain for name in names_that_scatter(member)}
    own = [
        name
        for name, declaration in stage.declarations().items()
        if declaration.scatter not in (Scattering.NONE, Scattering.COMPANION) and getattr(stage, name) is not None
    ]
    return inner | {*own, *(f"{stage.name}.{name}" for name in own)}


def _spread(stage: Stage, tolerance: Mapping[str, float], axes: int) -> Stage:
    """A stage whose uncertain parameters are lists with an entry per axis: axes scatter on their own."""
    if stage.inner_chains:
        return stage.with_inner_chains([[_spread(member, tolerance, axes) for member in chain] for chain in stage.inner_chains])
    return stage if axes == 1 else stage.spread(list(_named(stage, tolerance)), axes)


def _coefficients(stage: Stage, path: tuple[int, ...], tolerance: Mapping[str, float], axes: Sequence[str]) -> list[Coefficient]:
    found = [
        inner
        for b, chain in enumerate(stage.inner_chains)
        for m, member in enumerate(chain)
        for inner in _coefficients(member, (*path, b, m), tolerance, axes)
    ]
    known = stage.declarations()
    for name, share in _named(stage, tolerance).items():
        try:
            value = np.array(getattr(stage, name), dtype=float)
        except (TypeError, ValueError):
            continue  # lists of different lengths per axis: not scattered
        per_axis = len(axes) > 1 and known[name].per_axis is not None
        for index in np.ndindex(value.shape):
            if known[name].scatter is Scattering.COMPANION:
                found.append(Coefficient(path, name, index, None, share, f"{stage.name}.{name}{list(index)}", companion=True))
            elif value[index] != 0.0:
                place = index[1:] if per_axis else index
                label = name + "".join(f"[{i}]" for i in place) + (f" ({axes[index[0]]})" if per_axis else "")
                found.append(Coefficient(path, name, index, index[0] if per_axis else None, share, label))
    return found


def stage_at(stages: Sequence[Stage], path: tuple[int, ...]) -> Stage:
    """The stage that a coefficient's path leads to."""
    stage = stages[path[0]]
    return stage if len(path) == 1 else stage_at(stage.inner_chains[path[1]], path[2:])
