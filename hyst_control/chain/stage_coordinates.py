# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The declared parameters of a stage as single numbers, by name and axis, and back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.chain.parameter import Coordinate, Form, Parameter, Scattering

UNCERTAIN = (Scattering.RELATIVE, Scattering.ABSOLUTE, Scattering.POLES)
NEXT = 1e-3  # Share of the nominal value that is left of a number with an open bound at 0 which scatters beyond it


def of_parameters(known: Mapping[str, Parameter], values: Mapping[str, Any], axes: int) -> dict[tuple[str, int | None], Coordinate]:
    """Every number of the parameters that are declared as uncertain."""
    found: dict[tuple[str, int | None], Coordinate] = {}
    for name, parameter in known.items():
        if parameter.scatter not in UNCERTAIN or values[name] is None or parameter.form in (Form.FLAG, Form.COUNT, Form.CHAINS):
            continue
        for axis, entries in _by_axis(parameter, values[name], axes):
            size = float(np.mean(np.abs(entries)))
            for index in np.ndindex(entries.shape):
                value = float(entries[index])
                label = name + "".join(f"[{i}]" for i in index)
                found[label, axis] = Coordinate(value, max(abs(value), size), parameter.unit, name)
    return found


def changed(
    known: Mapping[str, Parameter], values: Mapping[str, Any], changes: Mapping[tuple[str, int | None], float], axes: int
) -> dict[str, Any]:
    """Parameters with other numbers in some of their places."""
    found = {}
    for name, parameter in known.items():
        own = {key: value for key, value in changes.items() if key[0].partition("[")[0] == name}
        if not own:
            continue
        parts = {axis: np.array(entries) for axis, entries in _by_axis(parameter, values[name], axes)}
        for (label, axis), value in own.items():
            index = tuple(int(part) for part in label[len(name) :].strip("[]").split("][") if part)
            parts[axis][index] = _bounded(parameter, float(parts[axis][index]), value)
        rows = [entries.tolist() for entries in parts.values()]
        found[name] = rows[0] if None in parts or axes == 1 else rows
    return found


def _by_axis(parameter: Parameter, value: Any, axes: int) -> list[tuple[int | None, Array]]:
    """The numbers of every axis; axis None for a parameter of all axes together."""
    if parameter.per_axis is None:
        try:
            return [(None, np.array(value, dtype=float))]
        except ValueError:
            return []  # lists of different lengths
    return [(axis, np.array(parameter.of_axis(parameter.spread(value, axes), axis), dtype=float)) for axis in range(axes)]


def _bounded(parameter: Parameter, nominal: float, value: float) -> float:
    value = min(max(value, parameter.lower), parameter.upper)
    if value <= parameter.above:
        value = parameter.above + NEXT * (nominal - parameter.above)
    if value >= parameter.below:
        value = parameter.below - NEXT * (parameter.below - nominal)
    return value
