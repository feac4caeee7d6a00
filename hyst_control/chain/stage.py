# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Stages: a frozen description with the model file's parameters, and the streaming filter it starts.

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

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from enum import Flag, auto
from typing import Any, ClassVar, TypeVar

import numpy as np

from hyst_control.base.arrays import Array as Array
from hyst_control.base.errors import InputError
from hyst_control.base.plugins import Registry
from hyst_control.chain import stage_coordinates
from hyst_control.chain.c_code.c_code import CCode, each_axis
from hyst_control.chain.parameter import Coordinate, Parameter, declared
from hyst_control.chain.parameter import depth as depth
from hyst_control.chain.parameter import frozen as frozen
from hyst_control.chain.parameter import per_axis as per_axis
from hyst_control.chain.parameter import per_axis_scalar as per_axis_scalar
from hyst_control.chain.parameter import per_axis_scalars as per_axis_scalars
from hyst_control.chain.parameter import scaled as scaled
from hyst_control.chain.parameter import thawed as thawed

HOLDS = ("zoh", "foh")

SLOW = 1e9
"""Sample time in s at which the rate terms of hysteresis stages vanish."""


@dataclass(frozen=True)
class Sampling:
    """Clock of a filter. Raises `InputError` when a value makes no sense."""

    sample_time: float  # s
    axes: int
    hold: str = "zoh"  # Of the signal that enters: `zoh` or `foh`
    # Ticks from `Filter.settle` to the first value of `Filter.process`, by the command's hold: 1 under `zoh`, where that
    # value is the one at the end of the first interval, 0 under `foh`. The same for every stage of a chain
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

    @property
    def first_tick(self) -> int:
        """`ahead`, which is known once the clock is made."""
        assert self.ahead is not None
        return self.ahead

    def with_hold(self, hold: str) -> Sampling:
        """The same clock for a signal of another hold."""
        return self if hold == self.hold else Sampling(self.sample_time, self.axes, hold, self.ahead)


class Filter:
    """A running stage: chunk-invariant, so any way of cutting a signal into blocks gives the same bits.

    `hold` is the hold of the output. `settle` must be called before the first `process`.
    """

    hold: str

    def settle(self, value: Array) -> Array:
        """Come to rest at the constant input `value` (A,), reached from 0 on the initial loading curve; return the output (A,)."""
        raise NotImplementedError

    def process(self, block: Array) -> Array:
        """Filter a block (N, A) of consecutive samples; the state carries over to the next block."""
        raise NotImplementedError

    def c_code(self) -> CCode:
        """The filter in C, see `chain.c_code`. Raises `InputError` with the reason where it has none."""
        raise InputError(f"{type(self).__name__}: the stage brings no C (Filter.c_code): leave it out, or give it its C")


class Role(Flag):
    """Roles of a class of stages, as the properties of `Stage` say in full."""

    NONE = 0
    LINEAR = auto()
    CHANGES_WITH_TIME = auto()  # does not commute with a delay
    MIXES_AXES = auto()
    HYSTERESIS = auto()
    HAS_COMPENSATOR = auto()
    MECHANICS = auto()


@dataclass(frozen=True, eq=False)  # a stage that declares no fields equals itself alone
class Stage:
    """Description of a stage: its fields are the model file's parameters, declared by `chain.parameter`.

    A number holds for every axis; a list where a number is due, or a list of lists where a list is due, is per axis.
    Subclasses set `name`, start a filter in `filter`, and check in `check` what relates several parameters. What others have
    to know of a stage are the properties and methods below, each with the answer of a stage that is nothing special.
    """

    name: ClassVar[str] = ""
    equation: ClassVar[str] = ""
    """Equation in LaTeX, from input u to output y, parameters upright by name; "" where words say it better."""
    place: ClassVar[str] = ""
    """Place of `effects.effect.PLACES` that the stage belongs to: what is inserted there goes behind it, what belongs to an
    earlier place before it. "" where it may be anywhere."""
    last_at_place: ClassVar[bool] = False
    """True for a stage that stands behind the others of its place."""
    unit_gain: ClassVar[bool] = False
    """True for a stage that a constant passes unchanged, whatever the parameters."""
    adds_hysteresis: ClassVar[bool] = False
    """True for a stage that is a chain's hysteresis where it has no other."""

    ROLES: ClassVar[Role] = Role.NONE
    """Answers of the properties below that are the same for every stage of the class; a stage may override a property instead."""
    sees_means: ClassVar[bool] = False
    """True for a stage with internal dynamics that respond to a fractional delay of a held command."""
    only_limits: ClassVar[bool] = False
    """True for a stage that only limits or rounds what it else passes unchanged: inverses and linear descriptions leave it out."""

    def __post_init__(self) -> None:
        for name in vars(self):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        for name, declaration in self.declarations().items():
            declaration.check(getattr(self, name))
        self.check()

    def check(self) -> None:
        """Raise `InputError` naming parameter and remedy when parameters do not fit together."""

    def filter(self, sampling: Sampling) -> Filter:
        """Start a filter of this stage for the clock `sampling`."""
        raise NotImplementedError

    def parameters(self) -> dict[str, Any]:
        """The parameters as they stand in a model file, without those left at their default."""
        return {
            field.name: thawed(getattr(self, field.name)) for field in fields(self) if getattr(self, field.name) != field.default
        }

    def declarations(self) -> Mapping[str, Parameter]:
        """Declaration of every parameter, by name; a stage whose values decide about a parameter's form says so here."""
        return declared(type(self))

    # Roles.

    @property
    def linear(self) -> bool:
        """True for a linear continuous-time system (see `chain.linear`), which may be merged with its neighbors."""
        return Role.LINEAR in self.ROLES

    @property
    def commutes_with_delay(self) -> bool:
        """True where delaying the input is the same as delaying the output, as it is for every time-invariant stage."""
        return Role.CHANGES_WITH_TIME not in self.ROLES

    @property
    def mixes_axes(self) -> bool:
        """True where an axis' output depends on other axes' inputs: delays that differ between the axes then stay on their side."""
        return Role.MIXES_AXES in self.ROLES

    @property
    def is_hysteresis(self) -> bool:
        """True for a stage that is, or contains, a plant's hysteresis."""
        return Role.HYSTERESIS in self.ROLES

    @property
    def has_compensator(self) -> bool:
        """True for a stage that is, or contains, a hysteresis that a feedforward compensator inverts by itself."""
        return Role.HAS_COMPENSATOR in self.ROLES

    @property
    def is_mechanics(self) -> bool:
        """True for a stage that may be a plant's mechanics."""
        return Role.MECHANICS in self.ROLES

    # The stage for other axes or other values.

    @property
    def inner_chains(self) -> tuple[tuple[Stage, ...], ...]:
        """Chains inside the stage: its branches."""
        return ()

    def with_inner_chains(self, chains: Sequence[Sequence[Stage]]) -> Stage:
        """The stage with other chains inside, as many as it has."""
        assert not chains, f"{self.name} has no chains inside"
        return self

    def for_axis(self, axis: int) -> Stage:
        """The stage of one axis, by its index, for a chain of one axis. Raises `InputError` where the stage mixes the axes."""
        if self.inner_chains:
            return self.with_inner_chains([[member.for_axis(axis) for member in chain] for chain in self.inner_chains])
        if self.mixes_axes:
            raise InputError(f"{self.name}: mixes the axes: it cannot be split by axis, take all axes together")
        return replace(self, **{key: known.of_axis(getattr(self, key), axis) for key, known in self.declarations().items()})

    def for_record(self, index: int | None) -> Stage:
        """The stage in one of several records, by its index, or in a run to come (None); what differs between records says how."""
        return self

    def spread(self, names: Sequence[str], axes: int) -> Stage:
        """The stage on so many axes, with the parameters of some names as one value per axis where they were one for all."""
        known = self.declarations()
        changed = {key: known[key].spread(getattr(self, key), axes) for key in names}
        return replace(self, **changed) if changed else self

    def with_values(self, values: Mapping[str, Array]) -> Stage:
        """The stage with scattered values of some parameters, by name, in the form that the stage has them.

        A stage whose parameters depend on each other brings them together again here. `tolerance` scatters every number by
        itself; an uncertainty stated in other coordinates (`Parameter.scatter`) comes back to the stage's own parameters here
        too.
        """
        return replace(self, **values)

    def coordinates(self, axes: int) -> dict[tuple[str, int | None], Coordinate]:
        """Numbers in which the uncertainty of the stage is stated: its own parameters, or what is known better one by one.

        By name, as `weights[3]`, and axis; None for what belongs to all axes together.
        """
        return stage_coordinates.of_parameters(self.declarations(), self._values(), axes)

    def with_coordinates(self, values: Mapping[tuple[str, int | None], float], axes: int) -> Stage:
        """The stage with other values of some of its `coordinates`, moved inside their bounds.

        Raises `InputError` where the values together make no such stage on so many axes.
        """
        return self.with_values(stage_coordinates.changed(self.declarations(), self._values(), values, axes))

    def _values(self) -> dict[str, Any]:
        return {name: getattr(self, name) for name in self.declarations()}

    # Answers to effects, control and diagnosis.

    def companion_size(self, index: tuple[int, ...]) -> float:
        """Amount in the measurement's unit that 1 stands for in a parameter that scatters as a session effect, at an index."""
        return 1.0

    def with_loop_width(self, width: Array) -> Stage | None:
        """The stage with loops wider by 1 + width (A,), the mean curve kept; None where it has no loop."""
        return None

    def with_rate_part(self, factor: Array) -> Stage | None:
        """The stage with its rate-dependent part times a factor (A,); None where it has no such part."""
        return None

    def with_rate_parts(self, rising: Array, falling: Array) -> Stage | None:
        """The same by direction, with factors rising and falling (A,); their mean where a stage makes no difference."""
        return self.with_rate_part(0.5 * (rising + falling))

    def with_operators(self, thresholds: Array, weights: Array) -> Stage | None:
        """The stage with other operators with memory; None where it has none.

        thresholds (A,) is the factor of all thresholds, weights (A,) that of all weights but the narrowest operator's, which
        follows the command at once.
        """
        return None

    def mean_slope(self, axes: int) -> Array | None:
        """Mean slope (A,) of a hysteresis on so many axes, output unit per input unit; None for any other stage."""
        return None

    def linearized(self, axes: int) -> tuple[Stage, ...] | None:
        """Linear stages in its place for small signals on so many axes; empty where it changes none, None where none does."""
        return () if self.only_limits else None

    def followed(self, stage: Stage) -> tuple[Stage, ...]:
        """This stage and the one right behind it as a chain starts them."""
        return self, stage

    def at_rest(self, signal: Array) -> Array:
        """Output without rates, delays and dynamics, rows (N, A).

        Every value of the signal (N, A) is held until all has settled, from rest at 0.
        """
        running = self.filter(Sampling(SLOW, signal.shape[1], "foh"))
        running.settle(signal[0])
        return running.process(np.ascontiguousarray(signal))


class ThroughFilter(Filter):
    """Passes the signal through unchanged."""

    def __init__(self, hold: str) -> None:
        self.hold = hold

    def settle(self, value: Array) -> Array:
        return np.array(value, dtype=float)

    def process(self, block: Array) -> Array:
        return block.copy()

    def c_code(self) -> CCode:
        return each_axis("u", "through", {})


@dataclass(frozen=True, eq=False)
class Modifier(Stage):
    """A stage that changes the stages before it instead of the signal; a chain lets it do so when it starts.

    Read by itself, as from a model file, it passes the signal through.
    """

    def applied(self, before: tuple[Stage, ...], axes: int) -> tuple[Stage, ...]:
        """The stages before this one, in signal order, changed.

        Raises `InputError` where it could change none of them on so many axes.
        """
        raise NotImplementedError

    def filter(self, sampling: Sampling) -> Filter:
        for name, declaration in self.declarations().items():
            value = getattr(self, name)
            if declaration.per_axis == 0 and value is not None:
                per_axis_scalar(value, sampling.axes, name)
        return ThroughFilter(sampling.hold)


STAGES: Registry[type[Stage]] = Registry(
    "stages",
    "a Stage of this name",
    lambda name, value: isinstance(value, type) and issubclass(value, Stage) and value.name == name,
)
"""Every stage by its name in the model file."""

Registered = TypeVar("Registered", bound=type[Stage])


def register(stage: Registered) -> Registered:
    """Class decorator that makes a stage known to the model file.

    Parameters
    ----------
    stage
        A class derived from `Stage`.

    Returns
    -------
    type
        The same class.

    Raises
    ------
    TypeError
        A field declares no parameter.
    InputError
        Its name is another stage's.
    """
    for field in fields(stage):
        if "parameter" not in field.metadata:
            raise TypeError(f"{stage.__name__}.{field.name}: declares no parameter: see hyst_control.chain.parameter")
    other = STAGES.added(stage.name)
    if (
        other is not None and f"{other.__module__}.{other.__qualname__}" != f"{stage.__module__}.{stage.__qualname__}"
    ):  # not loaded again
        raise InputError(f"{stage.name}: {other.__module__} has a stage of this name: choose another one")
    STAGES[stage.name] = stage
    return stage


def replaced(stages: Sequence[Stage], change: Callable[[Stage], Stage | None]) -> tuple[Stage, ...] | None:
    """Replace stages, also those inside others.

    Parameters
    ----------
    stages
        In signal order.
    change
        Another stage for one, or None to keep it.

    Returns
    -------
    tuple of Stage or None
        The stages with their replacements; None where every one is kept.
    """
    found = [_replaced(stage, change) for stage in stages]
    if all(new is None for new in found):
        return None
    return tuple(old if new is None else new for new, old in zip(found, stages, strict=True))


def _replaced(stage: Stage, change: Callable[[Stage], Stage | None]) -> Stage | None:
    if not stage.inner_chains:
        return change(stage)
    chains = [replaced(chain, change) for chain in stage.inner_chains]
    if all(chain is None for chain in chains):
        return None
    return stage.with_inner_chains([new or old for new, old in zip(chains, stage.inner_chains, strict=True)])
