# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Declaration of a number, text, truth value or list of them: unit, meaning, default, bounds; with the check and its message."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from numbers import Real
from typing import Any, Generic, NoReturn, TypeVar, cast

from hyst_control.base.errors import InputError

T = TypeVar("T")


@dataclass(frozen=True)
class Kind(Generic[T]):
    """Type of a value: its words in a message, and the conversion of what was given, which raises `TypeError` or `ValueError`."""

    name: str
    convert: Callable[[object], T]


def _integer(value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, Real) or not float(value).is_integer():
        raise ValueError
    return int(cast("int", value))


def _number(value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, Real) or not math.isfinite(value):
        raise ValueError
    return float(value)


def _unchanged(value: object, kind: type[T]) -> T:
    if not isinstance(value, kind):
        raise TypeError
    return value


def list_of(kind: Kind[T], name: str) -> Kind[tuple[T, ...]]:
    """Kind of a list, whose every value is of another kind; a single value is a list of one."""

    def convert(value: object) -> tuple[T, ...]:
        if isinstance(value, (str, bytes)):
            raise TypeError
        return tuple(kind.convert(item) for item in (value if isinstance(value, Iterable) else [value]))

    return Kind(name, convert)


INTEGER = Kind("an integer", _integer)
NUMBER = Kind("a number", _number)
TRUTH = Kind("true or false", partial(_unchanged, kind=bool))
TEXT = Kind("a text", partial(_unchanged, kind=str))
OF_TYPE: dict[type, Kind[Any]] = {int: INTEGER, float: NUMBER, bool: TRUTH, str: TEXT}
LISTS: dict[type, Kind[Any]] = {
    int: list_of(INTEGER, "a list of integers"),
    float: list_of(NUMBER, "a list of numbers"),
    bool: list_of(TRUTH, "a list of true or false"),
    str: list_of(TEXT, "a list of texts"),
}


@dataclass(frozen=True)
class Quantity:
    """One declared value."""

    name: str
    default: Any  # None where there is none, or where it is chosen later
    unit: str  # "" where it has none
    meaning: str
    # Bounds of the value, or of each value of a list: >= lower, <= upper, > above, < below
    lower: float = -math.inf
    upper: float = math.inf
    above: float = math.nan
    below: float = math.nan
    choices: tuple[str, ...] = ()  # All texts allowed, or the words allowed in place of a number
    kind: Any = None  # `Kind`; from the default where none is given

    def __post_init__(self) -> None:
        if self.kind is None:
            kind = LISTS[type(self.default[0])] if isinstance(self.default, tuple) else OF_TYPE[type(self.default)]
            object.__setattr__(self, "kind", kind)

    def within(self, number: float) -> bool:
        """True for a number within the bounds."""
        return self.lower <= number <= self.upper and not (number <= self.above or number >= self.below)

    @property
    def bounds(self) -> str:
        """The bounds in words, such as ">= 0" or "from 0 to 1"; empty where there is none."""
        if math.isfinite(self.lower) and math.isfinite(self.upper):
            return f"from {self.lower:g} to {self.upper:g}"
        signs = (">=", self.lower), (">", self.above), ("<=", self.upper), ("<", self.below)
        return " and ".join(f"{sign} {bound:g}" for sign, bound in signs if math.isfinite(bound))

    @property
    def values(self) -> str:
        """The bounds or all choices in words; empty where every value of the kind is allowed."""
        if self.kind is TEXT and self.choices:
            return ", ".join(self.choices)
        return " or ".join(filter(None, [self.bounds, *self.choices]))

    @property
    def requirement(self) -> str:
        """In words, what a value must be."""
        if self.kind is TEXT and self.choices:
            return f"one of {', '.join(self.choices)}" if len(self.choices) > 1 else self.choices[0]
        unit = f" {self.unit}" if self.unit and self.bounds else f" in {self.unit}" if self.unit else ""
        return " or ".join([f"{self.kind.name} {self.bounds}".rstrip() + unit, *self.choices])

    def checked(self, value: object) -> Any:
        """The value in its type; raises `InputError` that names what is allowed where it has another type or is out of bounds."""
        if isinstance(value, str) and value in self.choices:
            return value
        try:
            converted = self.kind.convert(value)
        except (OverflowError, TypeError, ValueError):
            self.refuse(value)
        for item in converted if isinstance(converted, tuple) else (converted,):
            if isinstance(item, str) and self.choices and item not in self.choices:
                self.refuse(item)
            if isinstance(item, (int, float)) and not self.within(item):
                self.refuse(item)
        return converted

    def refuse(self, value: object) -> NoReturn:
        """Raise the `InputError` of a value that is not allowed."""
        words = self.requirement
        text = f"{value:g}" if isinstance(value, float) and self.kind is not INTEGER else repr(value)
        if isinstance(value, float) and not math.isfinite(value):
            words = words.replace("number", "finite number", 1)
        raise InputError(f"{self.name}: must be {words}, got {shortened(text)}")


def shown(value: Any) -> str:
    """A default in words; empty for none."""
    if value is None:
        return ""
    if isinstance(value, (tuple, list)):
        return f"[{', '.join(shown(item) for item in value)}]"
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else str(value)


def shortened(text: str) -> str:
    """A text of at most 60 characters."""
    return text if len(text) <= 60 else f"{text[:57]}..."
