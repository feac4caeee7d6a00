# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Declarations of a stage's parameters: kind, unit, bounds, way of scattering, and one sentence each.

A stage is a frozen dataclass whose fields say what they are:

    tau: ScalarPerAxis = scalar("s", "transport delay", lower=0.0)

The checks, the split of a model by axis, the uncertainty and the reference in the documents all come from this one declaration.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields, replace
from enum import Enum
from functools import cached_property
from typing import Annotated, Any, TypeAlias, cast

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.base.quantity import INTEGER, NUMBER, TRUTH, Quantity, shortened
from hyst_control.chain.bounded_cache import PLAIN

ScalarPerAxis: TypeAlias = float | Sequence[float] | Array
"""A number for every axis alike, or a list with one per axis; a stage keeps it as a number or a tuple."""
VectorPerAxis: TypeAlias = Sequence[float] | Sequence[Sequence[float]] | Sequence[Array] | Array
"""A list for every axis alike, or a list of lists, one per axis."""
AllAxes: TypeAlias = (
    float | Sequence[float] | Sequence[Sequence[float]] | Sequence[Sequence[Sequence[float]]] | Sequence[Array] | Array
)
"""A number, list or matrix that belongs to all axes together."""

SHAPES = ("a number", "a list of numbers", "a matrix (a list of rows)", "a list of matrices")  # Words for a number of dimensions


class Form(Enum):
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
class Parameter(Quantity):
    """Declaration of one parameter of a stage."""

    form: Form = Form.SCALAR  # Form in the model file, which tells how it belongs to the axes
    infinite: bool = False  # Whether infinite numbers are allowed
    # Nesting of a parameter of all axes: 0 a number, 1 a list, 2 a matrix; several where it may have several
    dimensions: tuple[int, ...] = ()
    scatter: Scattering = Scattering.RELATIVE  # The way in which it is uncertain

    @cached_property
    def per_axis(self) -> int | None:
        """Dimensions of one axis' value; None for a parameter of all axes together."""
        return {Form.SCALAR: 0, Form.VECTOR: 1}.get(self.form)

    @cached_property
    def nestings(self) -> tuple[int, ...]:
        """Depths of nesting that a value may have."""
        return self.dimensions if self.per_axis is None else (self.per_axis, self.per_axis + 1)

    def check(self, value: Any) -> None:
        """Raise `InputError` naming the parameter and the remedy unless a value has the declared form and bounds."""
        if value is None and self.default is None or self.form is Form.CHAINS:
            return
        if self.form in (Form.FLAG, Form.COUNT):
            if self.checked(value) is not value:  # a count of 2.0 would reach a kernel as such
                self.refuse(value)
            return
        self._check_numbers(value)
        if nesting(value) not in self.nestings:
            raise InputError(f"{self.name}: must be {self.shape}, got {shortened(repr(value))}")

    @property
    def shape(self) -> str:
        """The nesting of a value, in words."""
        if self.per_axis is not None:
            return f"{SHAPES[self.per_axis]} for all axes, or a list with one of them per axis"
        return " or ".join(SHAPES[count] for count in self.dimensions) or self.form.value

    def _check_numbers(self, value: Any) -> None:
        if isinstance(value, tuple):
            if not value:
                raise InputError(f"{self.name}: is empty, at least one value is needed")
            for item in value:
                self._check_numbers(item)
            return
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not self.within(value):
            self.refuse(value)
        if value - value != 0.0:  # infinite
            if not self.infinite:
                self.refuse(value)
        elif self.kind is INTEGER and value % 1.0:
            self.refuse(value)

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
    """Spread a checked parameter over the axes."""
    found = depth(value)
    if found == due:
        return [np.array(value, dtype=float)] * axes
    if found == due + 1:
        items = cast(Sequence[Any], value)
        if len(items) != axes:
            raise InputError(f"{field}: {len(items)} values for {axes} axes: give one for all or one per axis")
        return [np.array(item, dtype=float) for item in items]
    raise InputError(f"{field}: nested {found} deep, give {due} (all axes alike) or {due + 1} (per axis)")


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


def scalar(unit: str, text: str, *, default: Any = MISSING, **declared: Any) -> Any:
    """Declare a field that is a number for every axis alike or a list with one per axis."""
    return _field(Form.SCALAR, unit, text, default, **declared)


def vector(unit: str, text: str, *, default: Any = MISSING, **declared: Any) -> Any:
    """Declare a field that is a list for every axis alike or a list of lists, one per axis."""
    return _field(Form.VECTOR, unit, text, default, **declared)


def all_axes(unit: str, text: str, *dimensions: int, default: Any = MISSING, **declared: Any) -> Any:
    """Declare a field that belongs to all axes together."""
    return _field(Form.ALL_AXES, unit, text, default, dimensions=dimensions, **declared)


def count(text: str, *, default: Any = MISSING) -> Any:
    """Declare a field that is a whole number, and known exactly."""
    return _field(Form.COUNT, "", text, default, lower=0, whole=True, scatter=Scattering.NONE)


def flag(text: str) -> Any:
    """Declare a field that is true or false, and false by default."""
    return _field(Form.FLAG, "", text, False, kind=TRUTH, scatter=Scattering.NONE)


def chains(text: str) -> Any:
    """Declare a field that is a list of chains; `text` is one phrase for the documents."""
    return _field(Form.CHAINS, "", text, MISSING, scatter=Scattering.NONE)


def _field(form: Form, unit: str, text: str, default: Any, whole: bool = False, kind: Any = NUMBER, **declared: Any) -> Any:
    described = Parameter("", default, unit, text, form=form, kind=INTEGER if whole else kind, **declared)
    metadata = {"parameter": described}
    return field(metadata=metadata) if default is MISSING else field(default=default, metadata=metadata)


_DECLARED: dict[type, Mapping[str, Parameter]] = {}


def declared(owner: type) -> Mapping[str, Parameter]:
    """Declarations of a stage class, the `owner`, by field name, in the order of its fields."""
    if owner not in _DECLARED:
        described = {found.name: found.metadata["parameter"] for found in fields(owner) if "parameter" in found.metadata}
        _DECLARED[owner] = {name: replace(each, name=name) for name, each in described.items()}
    return _DECLARED[owner]
