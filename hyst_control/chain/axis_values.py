# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Parameter values of stages: frozen and thawed, and spread over the axes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, cast

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.chain.bounded_cache import PLAIN
from hyst_control.chain.parameter import AllAxes, ScalarPerAxis, VectorPerAxis


def frozen(value: Any) -> Any:
    """Nested lists and arrays as nested tuples of Python numbers."""
    if type(value) in PLAIN:
        return value
    if isinstance(value, np.ndarray):
        return frozen(value.tolist())
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, (list, tuple)):
        return tuple(value) if PLAIN.issuperset(map(type, value)) else tuple(map(frozen, value))
    return value


def thawed(value: Any) -> Any:
    """Nested tuples as nested lists, as YAML writes them."""
    return [thawed(item) for item in value] if isinstance(value, tuple) else value


def depth(value: Any) -> int:
    """Nesting depth of a checked value."""
    return 1 + (depth(value[0]) if value else 0) if isinstance(value, tuple) else 0


def per_axis(value: VectorPerAxis | ScalarPerAxis | AllAxes, axes: int, due: int, field: str) -> list[Array]:
    """Spread a parameter over the axes."""
    found = depth(value)
    if found == due:
        return [_array(value, due, field)] * axes
    if found == due + 1:
        items = cast(Sequence[Any], value)
        if len(items) != axes:
            raise InputError(f"{field}: {len(items)} values for {axes} axes: give one for all or one per axis")
        return [_array(item, due, field) for item in items]
    raise InputError(f"{field}: nested {found} deep, give {due} (all axes alike) or {due + 1} (per axis)")


def _array(value: Any, dimensions: int, field: str) -> Array:
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        array = np.zeros((0,) * (dimensions + 1))
    if array.ndim != dimensions:
        raise InputError(f"{field}: {value!r} is not {('a number', 'a list of numbers')[min(dimensions, 1)]}")
    return array


def per_axis_scalar(value: ScalarPerAxis, axes: int, field: str) -> Annotated[Array, "A"]:
    """Spread a parameter that is a number per axis over the axes."""
    if type(value) is float:
        return np.array([value] * axes)
    return np.array([float(item) for item in per_axis(value, axes, 0, field)])


def per_axis_scalars(stage: object, axes: int, *names: str) -> list[Array]:
    """Spread parameters of a stage that are a number per axis over the axes."""
    return [per_axis_scalar(getattr(stage, name), axes, name) for name in names]


def scaled(value: VectorPerAxis | ScalarPerAxis, factor: Annotated[Array, "A"], due: int, field: str) -> Any:
    """Multiply a parameter by a factor per axis."""
    return frozen([item * share for item, share in zip(per_axis(value, len(factor), due, field), factor, strict=True)])
