"""What a stage is: a frozen description with the model file's parameters, and the streaming filter it starts.

Every signal between stages is known by one value per sample interval and axis, and by its *hold*:

``zoh``
    the value holds over the interval [t_k, t_k+1): a DAC output and every rate-independent function of one;
``foh``
    the signal is continuous and the value is the one at the interval's end; it runs straight from the value before.

A filter fed with a ``zoh`` signal returns what its output is at the *end* of each interval (the left limit at t_k+1), so
the sample taken "at t_k, before command[k] acts" is the output of interval k - 1. A filter fed with a ``foh`` signal returns
the output at the same instant as the input sample.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hyst_control.errors import InputError

Array = NDArray[np.float64]

HOLDS = ("zoh", "foh")


@dataclass(frozen=True)
class Sampling:
    """How a filter is clocked: sample time (s), number of axes, and the hold of the signal entering it.

    ahead: ticks from `Filter.settle` to the first value of `Filter.process`, by the command's hold: 1 under `zoh`, where that
    value is the one at the end of the first interval, 0 under `foh`. The same for every stage of a chain.
    """

    sample_time: float
    axes: int
    hold: str = "zoh"
    ahead: int | None = None

    def __post_init__(self) -> None:
        if not (np.isfinite(self.sample_time) and self.sample_time > 0):
            raise InputError(f"sample_time: {self.sample_time!r} s is not a positive time")
        if self.axes < 1:
            raise InputError(f"axes: {self.axes!r}, at least one axis is needed")
        if self.hold not in HOLDS:
            raise InputError(f"hold: {self.hold!r} is not one of {', '.join(HOLDS)}")
        if self.ahead is None:
            object.__setattr__(self, "ahead", int(self.hold == "zoh"))

    def with_hold(self, hold: str) -> Sampling:
        """The same clock for a signal of another hold."""
        return Sampling(self.sample_time, self.axes, hold, self.ahead)


class Filter:
    """A running stage: chunk-invariant, so any way of cutting a signal into blocks gives the same bits.

    `hold` is the hold of the output. `settle` must be called before the first `process`.
    """

    hold: str

    def settle(self, value: Array) -> Array:
        """Come to rest at the constant input `value` (A,), reached from 0 on the virgin curve; return the output (A,)."""
        raise NotImplementedError

    def process(self, block: Array) -> Array:
        """Filter a block (N, A) of consecutive samples; the state carries over to the next block."""
        raise NotImplementedError


@dataclass(frozen=True)
class Stage:
    """Description of a stage: its fields are the model file's parameters.

    A number holds for every axis; a list where a number is due, or a list of lists where a list is due, is per axis.
    Subclasses set `name`, check their parameters in `check` and start a filter in `filter`.
    """

    name: ClassVar[str] = ""
    linear: ClassVar[bool] = False
    """Whether the stage is a linear continuous-time system (see `chain.linear`), which may be merged with its neighbours."""
    commutes_with_delay: ClassVar[bool] = True
    """Whether delaying the input is the same as delaying the output, as it is for every time-invariant stage."""
    mixes_axes: ClassVar[bool] = False
    """Whether an axis' output depends on other axes' inputs: delays that differ between the axes then stay on their side."""

    def __post_init__(self) -> None:
        for field in fields(self):
            object.__setattr__(self, field.name, frozen(getattr(self, field.name)))
        self.check()

    def check(self) -> None:
        """Raise `InputError` naming the parameter and the remedy when the parameters make no sense."""

    def filter(self, sampling: Sampling) -> Filter:
        """A filter of this stage for the given clock."""
        raise NotImplementedError

    def parameters(self) -> dict[str, Any]:
        """The parameters as they stand in a model file, without those left at their default."""
        return {
            field.name: thawed(getattr(self, field.name)) for field in fields(self) if getattr(self, field.name) != field.default
        }


class ThroughFilter(Filter):
    """Nothing happens."""

    def __init__(self, hold: str) -> None:
        self.hold = hold

    def settle(self, value: Array) -> Array:
        return np.array(value, dtype=float)

    def process(self, block: Array) -> Array:
        return block.copy()


@dataclass(frozen=True)
class Modifier(Stage):
    """A stage that changes the stages before it instead of the signal; a chain lets it do so when it starts.

    Its parameters are numbers, for every axis alike or a list with one per axis.
    """

    def applied(self, before: tuple[Stage, ...], axes: int) -> tuple[Stage, ...]:
        """The stages before it, changed. Raises `InputError` when there is nothing among them that it could change."""
        raise NotImplementedError

    def filter(self, sampling: Sampling) -> Filter:
        for field in fields(self):
            value = getattr(self, field.name)
            if value is not None:
                per_axis_scalar(value, sampling.axes, field.name)
        return ThroughFilter(sampling.hold)


STAGES: dict[str, type[Stage]] = {}
"""Every stage by its name in the model file."""


def register(stage: type[Stage]) -> type[Stage]:
    """Class decorator that makes a stage known to the model file."""
    STAGES[stage.name] = stage
    return stage


def frozen(value: Any) -> Any:
    """Nested lists and arrays as nested tuples of Python numbers."""
    if isinstance(value, np.ndarray):
        return frozen(value.tolist())
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, (list, tuple)):
        return tuple(frozen(item) for item in value)
    return value


def thawed(value: Any) -> Any:
    """Nested tuples as nested lists, as YAML writes them."""
    return [thawed(item) for item in value] if isinstance(value, tuple) else value


def depth(value: Any) -> int:
    """Nesting depth: 0 for a number, 1 for a list of numbers, and so on."""
    return 1 + (depth(value[0]) if value else 0) if isinstance(value, tuple) else 0


def per_axis(value: Any, axes: int, due: int, field: str) -> list[Array]:
    """Spread a parameter over the axes: one array of `due` dimensions per axis.

    Raises `InputError` when a per-axis list has another length than there are axes.
    """
    nesting = depth(value)
    if nesting == due:
        return [_array(value, due, field)] * axes
    if nesting == due + 1:
        if len(value) != axes:
            raise InputError(f"{field}: {len(value)} values for {axes} axes: give one for all or one per axis")
        return [_array(item, due, field) for item in value]
    raise InputError(f"{field}: nested {nesting} deep, {due} (all axes alike) or {due + 1} (per axis) is due")


def _array(value: Any, dimensions: int, field: str) -> Array:
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        array = np.zeros((0,) * (dimensions + 1))
    if array.ndim != dimensions:
        raise InputError(f"{field}: {value!r} is not {('a number', 'a list of numbers')[min(dimensions, 1)]}")
    return array


def per_axis_scalar(value: Any, axes: int, field: str) -> Array:
    """A number for every axis as an array (A,)."""
    return np.array([float(item) for item in per_axis(value, axes, 0, field)])


def require_finite(value: ArrayLike | Any, field: str, infinite_allowed: bool = False) -> None:
    """Raise `InputError` unless every number in the nested value is a finite number (or infinite where that is allowed)."""
    if isinstance(value, tuple):
        if not value:
            raise InputError(f"{field}: is empty, at least one value is needed")
        for item in value:
            require_finite(item, field, infinite_allowed)
    elif isinstance(value, bool) or not isinstance(value, (int, float)) or np.isnan(value):
        raise InputError(f"{field}: {value!r} is not a finite number")
    elif np.isinf(value) and not infinite_allowed:
        raise InputError(f"{field}: {value!r} is not a finite number")


def require_positive(value: Any, field: str, unit: str, zero_allowed: bool = False, infinite_allowed: bool = False) -> None:
    """Raise `InputError` unless every number in the nested value is positive (or zero, infinite, where that is allowed)."""
    require_finite(value, field, infinite_allowed)
    if isinstance(value, tuple):
        for item in value:
            require_positive(item, field, unit, zero_allowed, infinite_allowed)
    elif value < 0 or (value == 0 and not zero_allowed):
        raise InputError(f"{field}: {value:g} {unit} must be {'zero or ' if zero_allowed else ''}positive")
