# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Declarations of a stage's parameters: kind, unit, bounds, way of scattering, and one sentence each.

A stage is a frozen dataclass whose fields say what they are:

    tau: ScalarPerAxis = scalar("s", "transport delay", lower=0.0)

From this one declaration come the checks (`Parameter.check`), the split of a model by axis and the spreading over axes
(`Parameter.of_axis`, `Parameter.spread`), which numbers are uncertain (`Parameter.scatter`), and the reference of all stages
in the documents (`docs/reference/stages.py`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import MISSING, Field, dataclass, field, fields
from enum import Enum
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError

ScalarPerAxis: TypeAlias = float | Sequence[float] | Array
"""A number for every axis alike, or a list with one per axis; a stage keeps it as a number or a tuple."""
VectorPerAxis: TypeAlias = Sequence[float] | Sequence[Sequence[float]] | Sequence[Array] | Array
"""A list for every axis alike, or a list of lists, one per axis."""
AllAxes: TypeAlias = (
    float | Sequence[float] | Sequence[Sequence[float]] | Sequence[Sequence[Sequence[float]]] | Sequence[Array] | Array
)
"""A number, list or matrix that belongs to all axes together."""

SHAPES = ("a number", "a list of numbers", "a matrix (a list of rows)", "a list of matrices")
"""Words for a number of dimensions."""


class Kind(Enum):
    """Form of a parameter in the model file."""

    SCALAR = "number, or one per axis"
    VECTOR = "list, or one per axis"
    ALL_AXES = "all axes together"
    COUNT = "whole number"
    FLAG = "true or false"
    CHAINS = "list of chains"


class Scattering(Enum):
    """The way in which an identified parameter is uncertain.

    A `tolerance` of the model file is relative for all of them but `COMPANION`, which is absolute, of size 1 and needs none, and
    `NONE`, which never scatters. The others tell an identification in which coordinates its covariance is to be stated.
    """

    RELATIVE = "relative"
    ABSOLUTE = "absolute"
    POLES = "frequency and damping of the poles"
    COMPANION = "free in every hypothesis, about 0"
    NONE = "none"


@dataclass(frozen=True)
class Coordinate:
    """A number in which the uncertainty of a stage is stated."""

    value: float  # Nominal value
    # What a relative uncertainty of it refers to: its own size, or of a list's entry the mean size of the list, if that is larger
    size: float
    unit: str  # "" where it has none
    parameter: str  # Parameter of the model file that it is written in


@dataclass(frozen=True)
class Parameter:
    """Declaration of one parameter of a stage."""

    kind: Kind  # Form in the model file, which tells how it belongs to the axes
    unit: str  # "" where it has none
    text: str  # One phrase for the documents
    # lower, above, upper, below: Bounds of every number: >= lower, > above, <= upper, < below
    lower: float = -np.inf
    above: float = -np.inf
    upper: float = np.inf
    below: float = np.inf
    infinite: bool = False  # Whether infinite numbers are allowed
    whole: bool = False  # Whether every number is a whole one
    # Nesting of a parameter of all axes: 0 a number, 1 a list, 2 a matrix; several where it may have several
    dimensions: tuple[int, ...] = ()
    optional: bool = False  # Whether it may be left out without a value (`None`)
    scatter: Scattering = Scattering.RELATIVE  # The way in which it is uncertain

    @cached_property
    def per_axis(self) -> int | None:
        """Dimensions of one axis' value; None for a parameter of all axes together."""
        return {Kind.SCALAR: 0, Kind.VECTOR: 1}.get(self.kind)

    @cached_property
    def nestings(self) -> tuple[int, ...]:
        """Depths of nesting that a value may have."""
        return self.dimensions if self.per_axis is None else (self.per_axis, self.per_axis + 1)

    def check(self, name: str, value: Any) -> None:
        """Raise `InputError` naming the parameter and the remedy unless a value has the declared form and bounds."""
        if value is None and self.optional or self.kind is Kind.CHAINS:
            return
        if self.kind is Kind.FLAG:
            if not isinstance(value, bool):
                raise InputError(f"{name}: must be true or false, got {value!r}")
        elif self.kind is Kind.COUNT:
            if isinstance(value, bool) or not isinstance(value, int) or value < self.lower:
                raise InputError(f"{name}: must be a whole number >= {self.lower:g}, got {value!r}")
        else:
            self._check_numbers(name, value)
            if nesting(value) not in self.nestings:
                raise InputError(f"{name}: must be {self.form}, got {_short(value)}")

    @property
    def form(self) -> str:
        """The form of a value, in words."""
        if self.per_axis is not None:
            return f"{SHAPES[self.per_axis]} for all axes, or a list with one of them per axis"
        return " or ".join(SHAPES[count] for count in self.dimensions) or self.kind.value

    def _check_numbers(self, name: str, value: Any) -> None:
        if isinstance(value, tuple):
            if not value:
                raise InputError(f"{name}: is empty, at least one value is needed")
            for item in value:
                self._check_numbers(name, item)
            return
        if isinstance(value, bool) or not isinstance(value, (int, float)) or value != value:
            raise InputError(f"{name}: {_short(value)} is not a finite number")
        if not self.lower <= value <= self.upper or value <= self.above != -np.inf or value >= self.below != np.inf:
            bounds = (">=", self.lower), (">", self.above), ("<=", self.upper), ("<", self.below)
            told = " and ".join(f"{sign} {bound:g}" for sign, bound in bounds if np.isfinite(bound))
            raise InputError(f"{name}: must be {f'{told} {self.unit}'.strip()}, got {value:g}")
        if value - value != 0.0:  # infinite
            if not self.infinite:
                raise InputError(f"{name}: {value!r} is not a finite number")
        elif self.whole and value % 1.0:
            raise InputError(f"{name}: must be a whole number, got {value:g}")

    def of_axis(self, value: Any, axis: int) -> Any:
        """The value of one axis; one that all axes have alike or together stays."""
        due = self.per_axis
        return value if due is None or nesting(value) <= due else value[axis]

    def spread(self, value: Any, axes: int) -> Any:
        """A value that all axes have alike as one value per axis; any other as it is."""
        due = self.per_axis
        return (value,) * axes if due is not None and nesting(value) == due and value is not None else value


def nesting(value: Any) -> int:
    """Depth of a value of nested tuples: 0 for a number, 1 for a list of numbers, and so on; -1 where members differ in it."""
    if not isinstance(value, tuple):
        return 0
    depths = {nesting(item) for item in value}
    return 1 + depths.pop() if len(depths) == 1 and -1 not in depths else -1


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def scalar(unit: str, text: str, *, default: Any = MISSING, **declared: Any) -> Any:
    """Declare a field that is a number for every axis alike or a list with one per axis."""
    return _field(Parameter(Kind.SCALAR, unit, text, optional=default is None, **declared), default)


def vector(unit: str, text: str, *, default: Any = MISSING, **declared: Any) -> Any:
    """Declare a field that is a list for every axis alike or a list of lists, one per axis."""
    return _field(Parameter(Kind.VECTOR, unit, text, optional=default is None, **declared), default)


def all_axes(unit: str, text: str, *dimensions: int, default: Any = MISSING, **declared: Any) -> Any:
    """Declare a field that belongs to all axes together."""
    return _field(Parameter(Kind.ALL_AXES, unit, text, dimensions=dimensions, optional=default is None, **declared), default)


def count(text: str, *, default: Any = MISSING, lower: int = 0) -> Any:
    """Declare a field that is a whole number, and known exactly."""
    return _field(Parameter(Kind.COUNT, "", text, lower=lower, scatter=Scattering.NONE), default)


def flag(text: str, *, default: bool = False) -> Any:
    """Declare a field that is true or false."""
    return _field(Parameter(Kind.FLAG, "", text, scatter=Scattering.NONE), default)


def chains(text: str) -> Any:
    """Declare a field that is a list of chains; `text` is one phrase for the documents."""
    return _field(Parameter(Kind.CHAINS, "", text, scatter=Scattering.NONE), MISSING)


def _field(parameter: Parameter, default: Any) -> Any:
    metadata = {"parameter": parameter}
    return field(metadata=metadata) if default is MISSING else field(default=default, metadata=metadata)


_DECLARED: dict[type, Mapping[str, Parameter]] = {}


def declared(owner: type) -> Mapping[str, Parameter]:
    """Declarations of a stage class, the `owner`, by field name, in the order of its fields."""
    if owner not in _DECLARED:
        _DECLARED[owner] = {found.name: found.metadata["parameter"] for found in fields(owner) if "parameter" in found.metadata}
    return _DECLARED[owner]


def undeclared(owner: type) -> Iterator[Field[Any]]:
    """Fields of a stage class, the `owner`, that declare nothing."""
    return (found for found in fields(owner) if "parameter" not in found.metadata)
