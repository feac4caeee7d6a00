"""The scatter of a nominal model: which of its coefficients are uncertain, by how much, and the model for other values of them.

A nominal model whose coefficients are 1 % off looks like every effect at once; so each coefficient that the model file's
`tolerance` names becomes a nuisance parameter z with prior N(0, 1): value = nominal · (1 + tolerance · z).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from hyst_control.chain import Parallel, Stage
from hyst_control.chain.bounded_cache import KEPT
from hyst_control.chain.stage import Array, depth
from hyst_control.model_file import Model

LISTS = ("weights", "thresholds", "num", "den", "ascending", "descending", "decay", "frequency", "decay_change", "frequency_change")
"""Parameters that are a list for one axis."""

MATRICES = ("A", "B", "C", "D", "matrix", "outputs", "inputs", "feedthrough", "elongation", "force_inputs")
"""Parameters that belong to all axes together."""


@dataclass(frozen=True)
class Coefficient:
    """One uncertain number: the stage it is in (indices from the chain down through branches), its field and index in it."""

    path: tuple[int, ...]
    field: str
    index: tuple[int, ...]
    axis: int | None
    tolerance: float
    name: str


@dataclass(frozen=True)
class Scatter:
    """The uncertain coefficients of a model, whose shared parameters are spread over its axes."""

    model: Model
    coefficients: tuple[Coefficient, ...]
    _known: dict[bytes, tuple[Stage, ...]] = field(default_factory=dict, compare=False, repr=False)

    def at(self, z: Array) -> tuple[Stage, ...]:
        """The stages for nuisance values z (K,)."""
        key = z.tobytes()
        if key not in self._known:
            if len(self._known) >= KEPT:
                self._known.clear()
            self._known[key] = self._stages(z)
        return self._known[key]

    def _stages(self, z: Array) -> tuple[Stage, ...]:
        changes: dict[tuple[int, ...], dict[str, Any]] = {}
        for coefficient, value in zip(self.coefficients, z, strict=True):
            if value:
                stage = _find(self.model.chain.stages, coefficient.path)
                changed = changes.setdefault(coefficient.path, {})
                if coefficient.field not in changed:
                    changed[coefficient.field] = np.array(getattr(stage, coefficient.field), dtype=float)
                changed[coefficient.field][coefficient.index] *= 1.0 + coefficient.tolerance * value
        return tuple(_changed(stage, (i,), changes) for i, stage in enumerate(self.model.chain.stages))


def scatter_of(model: Model) -> Scatter:
    """Every coefficient that the model's tolerance names, by parameter or `stage.parameter`; zero coefficients have none."""
    axes = len(model.axes)
    spread = tuple(_spread(stage, model.tolerance, axes) for stage in model.chain.stages)
    found: list[Coefficient] = []
    for i, stage in enumerate(spread):
        found += _coefficients(stage, (i,), model.tolerance, model.axes)
    return Scatter(model.with_stages(spread), tuple(found))


def _named(stage: Stage, tolerance: Any) -> dict[str, float]:
    """Tolerance by field of a stage."""
    found = {}
    for parameter in fields(stage):
        value = tolerance.get(f"{stage.name}.{parameter.name}", tolerance.get(parameter.name))
        if value:
            found[parameter.name] = float(np.max(value))
    return found


def _spread(stage: Stage, tolerance: Any, axes: int) -> Stage:
    """A stage whose uncertain parameters are lists with an entry per axis: axes scatter on their own."""
    if isinstance(stage, Parallel):
        return Parallel(tuple(tuple(_spread(member, tolerance, axes) for member in branch) for branch in stage.branches))
    if axes == 1 or getattr(stage, "coupled", False):
        return stage
    changed = {}
    for name in _named(stage, tolerance):
        value = getattr(stage, name)
        if name not in MATRICES and not isinstance(value, (bool, str)) and depth(value) == (name in LISTS):
            changed[name] = (value,) * axes
    return replace(stage, **changed) if changed else stage


def _coefficients(stage: Stage, path: tuple[int, ...], tolerance: Any, axes: Sequence[str]) -> list[Coefficient]:
    if isinstance(stage, Parallel):
        return [
            found
            for b, branch in enumerate(stage.branches)
            for m, member in enumerate(branch)
            for found in _coefficients(member, (*path, b, m), tolerance, axes)
        ]
    found = []
    for name, share in _named(stage, tolerance).items():
        try:
            value = np.array(getattr(stage, name), dtype=float)
        except (TypeError, ValueError):
            continue  # lists of different lengths per axis: not scattered
        per_axis = len(axes) > 1 and name not in MATRICES and not getattr(stage, "coupled", False)
        for index in np.ndindex(value.shape):
            if value[index] != 0.0:
                place = index[1:] if per_axis else index
                label = name + "".join(f"[{i}]" for i in place) + (f" ({axes[index[0]]})" if per_axis else "")
                found.append(Coefficient(path, name, index, index[0] if per_axis else None, share, label))
    return found


def _find(stages: Sequence[Stage], path: tuple[int, ...]) -> Stage:
    stage = stages[path[0]]
    return stage if len(path) == 1 else _find(stage.branches[path[1]], path[2:])


def _changed(stage: Stage, path: tuple[int, ...], changes: dict[tuple[int, ...], dict[str, Any]]) -> Stage:
    if isinstance(stage, Parallel):
        return Parallel(
            tuple(
                tuple(_changed(member, (*path, b, m), changes) for m, member in enumerate(branch))
                for b, branch in enumerate(stage.branches)
            )
        )
    if path not in changes:
        return stage
    return replace(stage, **_closed(stage, changes[path]))


def _closed(stage: Stage, changed: dict[str, Any]) -> dict[str, Any]:
    """Madelung's two major branches end at one point: each is scaled to the mean of their ends."""
    if stage.name != "madelung" or getattr(stage, "knots", None) is not None:
        return changed
    up, down = (np.array(changed.get(name, getattr(stage, name)), dtype=float) for name in ("ascending", "descending"))
    ends = up.sum(axis=-1, keepdims=True), down.sum(axis=-1, keepdims=True)
    mean = 0.5 * (ends[0] + ends[1])
    return {**changed, "ascending": up * mean / ends[0], "descending": down * mean / ends[1]}
