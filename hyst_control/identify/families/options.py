# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Options of an estimator as data: declared once, checked and converted for scripts, command line and nodes alike."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import MISSING, dataclass, field, fields, replace
from typing import Any, TypeVar, cast

from hyst_control.base.errors import InputError
from hyst_control.base.quantity import INTEGER as INTEGER
from hyst_control.base.quantity import NUMBER as NUMBER
from hyst_control.base.quantity import TEXT as TEXT
from hyst_control.base.quantity import TRUTH as TRUTH
from hyst_control.base.quantity import Kind as Kind
from hyst_control.base.quantity import Quantity, list_of

T = TypeVar("T")
D = TypeVar("D")
METHODS = {
    "joint": "all records together",
    "paper": "the paper's own sequence, in which every step inherits the errors of the ones before",
}


NUMBERS = list_of(NUMBER, "numbers separated by commas")
TRUTHS = {"true": True, "yes": True, "false": False, "no": False}
PARSED: dict[Kind[Any], Callable[[str], object]] = {
    INTEGER: int,
    NUMBER: float,
    NUMBERS: lambda text: tuple(map(float, text.split(","))),
    TRUTH: lambda text: TRUTHS[text.lower()],
}
"""Conversions of the text of an option."""


@dataclass(frozen=True)
class Option(Quantity):
    """One option of an estimator: its name is that of the field, the keyword and the node's parameter, and `--name` on the command line."""

    methods: tuple[str, ...] = ()  # Methods that have this option; empty: all

    def checked(self, value: object) -> Any:
        """Convert a value or its text to the option's type and check it; None passes where the default is None."""
        if value is None and self.default is None:
            return None
        if isinstance(value, str) and value not in self.choices and self.kind in PARSED:
            try:
                value = PARSED[self.kind](value)
            except (KeyError, ValueError):
                self.refuse(value)
        return super().checked(value)


def option(default: D, kind: Kind[T], meaning: str, *, unit: str = "", methods: tuple[str, ...] = (), **declared: Any) -> D | T:
    """Declare an option as a field of a dataclass derived from `Options`.

    Parameters
    ----------
    default, kind, meaning, unit, **declared
        As in `Quantity`, for bounds and choices.
    methods
        Methods that have this option; all where none is named.

    Returns
    -------
    D | T
        The dataclass field, in the type of its values.
    """
    described = Option("", default, unit, meaning, kind=kind, methods=methods, **declared)
    return cast("D | T", field(default=default, metadata={"option": described}))


@dataclass(frozen=True)
class Options:
    """Options of a fit. An estimator derives its own, every field declared by `option`; values are converted and checked."""

    method: str = option("joint", TEXT, METHODS["joint"], choices=("joint",))

    def __post_init__(self) -> None:
        for each in declared(type(self)):
            object.__setattr__(self, each.name, each.checked(getattr(self, each.name)))
        for each in declared(type(self)):
            if each.methods and self.method not in each.methods and getattr(self, each.name) != each.default:
                raise InputError(f"{each.name}: method {self.method} does not have this option: omit it")
        self.check()

    def check(self) -> None:
        """Raise `InputError` for inconsistent values."""


def methods_option(*methods: str) -> str:
    """Declare the field `method` of an estimator that has several methods.

    Parameters
    ----------
    *methods
        The methods, the default first.

    Returns
    -------
    str
        The dataclass field.
    """
    return option(methods[0], TEXT, "; ".join(f"{name}: {METHODS[name]}" for name in methods), choices=methods)


def declared(options: type[Options]) -> tuple[Option, ...]:
    """Return the options that a class declares, in order.

    Parameters
    ----------
    options
        The class.

    Returns
    -------
    tuple[Option, ...]
        An option a field.
    """
    found = []
    for each in fields(options):
        described = each.metadata.get("option")
        if described is None or each.default is MISSING:
            raise TypeError(f"{options.__name__}.{each.name}: declare it by `option`")
        found.append(replace(described, name=each.name))
    return tuple(found)
