"""Options of an estimator as data: declared once, checked and converted for scripts, command line and nodes alike."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import MISSING, dataclass, field, fields, replace
from typing import Generic, TypeVar, cast

from hyst_control.base.errors import InputError

T = TypeVar("T")
D = TypeVar("D")
METHODS = {
    "joint": "all records together",
    "paper": "the paper's own sequence, in which every step inherits the errors of the ones before",
}


@dataclass(frozen=True)
class Kind(Generic[T]):
    """Type of an option.

    Parameters
    ----------
    name
        Its name in a message.
    convert
        Conversion of a text or a Python value, which raises `ValueError` where it fails.
    """

    name: str
    convert: Callable[[object], T]


@dataclass(frozen=True)
class Option:
    """One option of an estimator.

    Parameters
    ----------
    name
        Name of the field, the keyword and the node's parameter; on the command line with `--` before it and hyphens in it.
    default
        Value where none is given; None where the estimator chooses.
    meaning
        Meaning in a few words.
    kind
        Type of the values.
    unit
        Unit, empty for numbers without one.
    lower, upper
        Range, both ends included; None where there is no bound.
    choices
        All texts allowed, or the words allowed in place of a number.
    methods
        Methods that have this option; empty: all.
    """

    name: str
    default: object
    meaning: str
    kind: Kind[object]
    unit: str = ""
    lower: float | None = None
    upper: float | None = None
    choices: tuple[str, ...] = ()
    methods: tuple[str, ...] = ()

    def checked(self, value: object) -> object:
        """Convert a value or its text to the option's type and check it.

        Parameters
        ----------
        value
            Value or text; None where the default is None.

        Returns
        -------
        object
            The value in the option's type.

        Raises
        ------
        InputError
            The value is of another type or out of range; the message names the option and the values allowed.
        """
        if value is None and self.default is None:
            return None
        if isinstance(value, str) and value in self.choices:
            return value
        try:
            converted = self.kind.convert(value)
        except (TypeError, ValueError):
            raise InputError(f"{self.name}: must be {self.requirement()}, got {value!r}") from None
        if isinstance(converted, str) and self.choices:
            raise InputError(f"{self.name}: must be {self.requirement()}, got {value!r}")
        for number in converted if isinstance(converted, tuple) else (converted,):
            if isinstance(number, (int, float)) and not self._within(number):
                raise InputError(f"{self.name}: must be {self.requirement()}, got {number!r}")
        return converted

    def _within(self, number: float) -> bool:
        return (self.lower is None or number >= self.lower) and (self.upper is None or number <= self.upper)

    def requirement(self) -> str:
        """Return in words what a value must be."""
        if self.kind is TEXT and self.choices:
            return f"one of {', '.join(self.choices)}" if len(self.choices) > 1 else self.choices[0]
        words = f"{self.kind.name}{f' in {self.unit}' if self.unit else ''}{self.limits()}"
        return " or ".join([words, *self.choices])

    def limits(self) -> str:
        """Return the range in words, empty where there is none."""
        if self.lower is not None and self.upper is not None:
            return f" from {self.lower:g} to {self.upper:g}"
        if self.lower is not None:
            return f" >= {self.lower:g}"
        return "" if self.upper is None else f" <= {self.upper:g}"


def _whole(value: object) -> int:
    if isinstance(value, bool) or (isinstance(value, float) and not value.is_integer()):
        raise ValueError
    return int(cast(str, value))


def _number(value: object) -> float:
    if isinstance(value, bool):
        raise ValueError
    number = float(cast(str, value))
    if not math.isfinite(number):
        raise ValueError
    return number


def _numbers(value: object) -> tuple[float, ...]:
    parts = value.split(",") if isinstance(value, str) else cast("Iterable[object]", value)
    return tuple(_number(part) for part in parts)


def _truth(value: object) -> bool:
    words = {"true": True, "yes": True, "false": False, "no": False}
    if isinstance(value, str) and value.lower() in words:
        return words[value.lower()]
    if not isinstance(value, bool):
        raise ValueError
    return value


def _text(value: object) -> str:
    if not isinstance(value, str):
        raise ValueError
    return value


INTEGER = Kind("an integer", _whole)
NUMBER = Kind("a number", _number)
NUMBERS = Kind("numbers separated by commas", _numbers)
TRUTH = Kind("true or false", _truth)
TEXT = Kind("a text", _text)


def option(
    default: D,
    kind: Kind[T],
    meaning: str,
    *,
    unit: str = "",
    lower: float | None = None,
    upper: float | None = None,
    choices: tuple[str, ...] = (),
    methods: tuple[str, ...] = (),
) -> D | T:
    """Declare an option as a field of a dataclass derived from `Options`.

    Parameters
    ----------
    default, kind, meaning, unit, lower, upper, choices, methods
        As in `Option`.

    Returns
    -------
    D | T
        The dataclass field, in the type of its values.
    """
    described = Option("", default, meaning, cast("Kind[object]", kind), unit, lower, upper, choices, methods)
    return cast("D | T", field(default=default, metadata={"option": described}))


@dataclass(frozen=True)
class Options:
    """Options of a fit. An estimator derives its own, every field declared by `option`; values are converted and checked.

    Raises
    ------
    InputError
        Names the option whose value is of another type or out of range, or that the chosen method does not have.
    """

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

    Raises
    ------
    TypeError
        A field is not declared by `option`.
    """
    found = []
    for each in fields(options):
        described = each.metadata.get("option")
        if described is None or each.default is MISSING:
            raise TypeError(f"{options.__name__}.{each.name}: declare it by `option`")
        found.append(replace(described, name=each.name))
    return tuple(found)
