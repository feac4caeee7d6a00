# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A stage around a simulator that is a Python function of the whole command: what a diagnosis puts around other people's simulators.

    simulate(command, sample_time, **parameters) -> measurement

command[k] holds from tick k to tick k + 1, and measurement[k] is the sample at tick k, before command[k] acts; of a record with hold
`foh` command and measurement are samples at the same instants. Arrays are (N,) for one axis and (N, A) for several. The stage is no part
of the vocabulary of model files: a file that is read must not run functions by name.

docs/any_simulator.md says when it is called at finer steps, and what the attribute `vectorized` is for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, ClassVar, TypeAlias

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.chain.bounded_cache import KEPT
from hyst_control.chain.chain import Chain
from hyst_control.chain.linear.linear_stages import Delay
from hyst_control.chain.parameter import Coordinate
from hyst_control.chain.stage import Filter, Modifier, Role, Sampling, Stage

Simulate: TypeAlias = Callable[..., Any]


def title_of(simulate: Simulate) -> str:
    """Name of a simulator for people."""
    return getattr(simulate, "__qualname__", type(simulate).__qualname__)


RECENT = 4  # Calls whose measurement is kept
STEPS = 4  # Steps a tick of a function that can be called at finer ones
SAME = 1e-4  # Share of the range by which its samples may differ between both
SWING = (1.5, 1.5, 0.5, 0.5)  # Factors on a command by which it changes within a tick about the same mean
SLOW = 0.1  # Share of the range that they may move samples by: of a gain they move them by a quarter at least


@dataclass(frozen=True)
class ExternalSimulator(Modifier):
    """A Python function from command to measurement, as the plant; effects go before and behind it."""

    name: ClassVar[str] = "external_simulator"
    ROLES: ClassVar[Role] = Role.HYSTERESIS | Role.MIXES_AXES
    sees_means: ClassVar[bool] = True
    simulate: Simulate
    names: tuple[str, ...]
    values: tuple[float, ...]
    units: tuple[str, ...]
    steps: int = 1  # Steps a tick where the command changes within a tick
    # Shared by all that are made of one by other values: measurements of commands at rest, and of those that are computed together
    resting: dict[tuple[Any, ...], Array] = field(default_factory=dict, compare=False, repr=False)
    batch: dict[tuple[float, ...], dict[tuple[float, bytes], Array]] = field(default_factory=dict, compare=False, repr=False)
    recent: dict[tuple[Any, ...], Array] = field(default_factory=dict, compare=False, repr=False)  # Last measurements

    def parameters(self) -> dict[str, Any]:
        raise InputError(f"simulator {title_of(self.simulate)}: a Python function is no model file: keep function and parameters")

    def coordinates(self, axes: int) -> dict[tuple[str, int | None], Coordinate]:
        rows = zip(self.names, self.values, self.units, strict=True)
        return {(name, None): Coordinate(value, abs(value), unit, name) for name, value, unit in rows}

    def with_coordinates(self, values: Mapping[tuple[str, int | None], float], axes: int) -> Stage:
        known = zip(self.names, self.values, strict=True)
        return replace(self, values=tuple(values.get((name, None), value) for name, value in known))

    def filter(self, sampling: Sampling) -> Filter:
        return ExternalFilter(self, sampling)

    def applied(self, before: tuple[Stage, ...], axes: int) -> tuple[Stage, ...]:
        """With the lags and delays right before it within, if it can be called at finer steps."""
        begin = len(before)
        while self.steps > 1 and begin and (before[begin - 1].linear or isinstance(before[begin - 1], Delay)):
            begin -= 1
        if begin == len(before):
            return *before, self
        return *before[:begin], FinelyStepped((*before[begin:], replace(self, steps=1)), self.steps)

    def stepped(self, command: Annotated[Array, "N A"], sample_time: float) -> ExternalSimulator:
        """The same with finer steps, if these give the same samples of a held command, and its samples are not of the last step alone."""
        held = np.repeat(command, STEPS, axis=0)
        swung = command[0] + np.tile(SWING, len(command))[:, None] * (held - command[0])
        expected = self.run(command, sample_time)
        try:
            found = [self.run(rows, sample_time / STEPS)[::STEPS] for rows in (held, swung)]
        except InputError:
            return self
        same, slow = (
            np.max(np.abs(rows - expected)) <= share * np.ptp(expected) for rows, share in zip(found, (SAME, SLOW), strict=True)
        )
        return replace(self, steps=STEPS) if same and slow else self

    def settled(self, command: Annotated[Array, "A"], sample_time: float) -> Annotated[Array, "A"]:
        """Measurement at rest at a command."""
        key = (self.values, command.tobytes(), sample_time)
        if key not in self.resting:
            if len(self.resting) >= KEPT:
                self.resting.clear()
            self.resting[key] = self.run(np.repeat(command[None], 2, axis=0), sample_time)[0]
        return self.resting[key]

    def followed(self, stage: Stage) -> tuple[Stage, ...]:
        """With a lag behind it within, if it can be called at finer steps."""
        if self.steps == 1 or not stage.linear:
            return self, stage
        return (FinelyStepped((replace(self, steps=1), stage), self.steps),)

    def run(self, command: Array, sample_time: float) -> Array:
        """Measurement (N, A) of a command (N, A)."""
        if self.values in self.batch:
            known, key = self.batch[self.values], (sample_time, command.tobytes())
            if key not in known:
                columns = np.array(list(self.batch)).T
                for each, rows in zip(self.batch.values(), self._called(command, sample_time, columns), strict=True):
                    each[key] = rows
            output = known[key]
        else:
            output = self._recalled(command, sample_time)
        if not np.isfinite(output).all():
            row = int(np.argmin(np.isfinite(output).all(axis=1)))
            told = ", ".join(f"{name} = {value:g}" for name, value in zip(self.names, self.values, strict=True))
            raise InputError(
                f"simulator {title_of(self.simulate)}: is not finite at sample {row} with {told or 'no parameters'}: check its dynamics"
            )
        return output

    def _recalled(self, command: Array, sample_time: float) -> Array:
        """Measurement, of the last few calls as it was."""
        key = self.values, sample_time, command.tobytes()
        if key not in self.recent:
            if len(self.recent) >= RECENT:
                self.recent.pop(next(iter(self.recent)))
            self.recent[key] = self._called(command, sample_time, self.values)
        return self.recent[key]

    def _called(self, command: Array, sample_time: float, values: Sequence[Any] | Array) -> Array:
        """Measurement (N, A), or (P, N, A) where each of the values is an array (P,)."""
        where, (count, axes), sets = f"simulator {title_of(self.simulate)}", command.shape, np.shape(values)[1:]
        parameters = dict(zip(self.names, values, strict=True))
        try:
            given = self.simulate(command[:, 0].copy() if axes == 1 else command.copy(), sample_time, **parameters)
            if np.iscomplexobj(given):
                raise TypeError("complex values: return real ones")
            output = np.array(given, dtype=float)
        except (Exception, SystemExit) as error:  # of any kind: it is foreign code
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            told = (f"{name}={value.tolist() if sets else format(value, 'g')}" for name, value in parameters.items())
            called = ", ".join(["command", f"{sample_time:g}", *told])
            raise InputError(f"{where}: {reason}: mend it, and try {title_of(self.simulate)}({called})") from None
        if output.shape not in ((*sets, count, axes), (*sets, count) if axes == 1 else (*sets, count, axes)):
            raise InputError(
                f"{where}: gives values of shape {output.shape} for a command of {count} samples and {axes} axes"
                f"{f' and {sets[0]} sets of parameters' if sets else ''}: return one row per sample"
            )
        return output.reshape(*sets, count, axes)


@contextmanager
def together(chains: Iterable[Sequence[Stage]]) -> Iterator[bool]:
    """Within, a vectorized simulator computes the values of all these chains in one call a command; True where there is one."""
    found: list[ExternalSimulator] = []
    for chain in chains:  # of which all have the same stages by other values
        here = [stage for stage in chain if isinstance(stage, ExternalSimulator) and getattr(stage.simulate, "vectorized", False)]
        if not here:
            break  # the others need not be built
        found += here
    for stage in found:
        stage.batch[stage.values] = {}
    try:
        yield bool(found)
    finally:
        for stage in found:
            stage.batch.clear()


class ExternalFilter(Filter):
    """The function called with the whole command so far: the same for every way of cutting it, as long as the function is causal."""

    hold = "foh"

    def __init__(self, stage: ExternalSimulator, sampling: Sampling) -> None:
        self.stage, self.sampling = stage, sampling
        self.command = np.empty((0, sampling.axes))

    def settle(self, value: Array) -> Array:
        begin = np.asarray(value, dtype=float)[None]
        self.command = begin if self.sampling.first_tick else begin[:0]
        return self.stage.settled(begin[0], self.sampling.sample_time)

    def process(self, block: Array) -> Array:
        self.command = np.concatenate([self.command, block])
        return self.stage.run(self._held(), self.sampling.sample_time)[-len(block) :] if len(block) else block.copy()

    def _held(self) -> Array:
        """Command at every tick: what is continuous is held at the means between its ticks."""
        if not self.sampling.first_tick:
            return self.command
        if self.sampling.hold == "zoh":
            return np.concatenate([self.command[1:], self.command[-1:]])
        return np.concatenate([0.5 * (self.command[1:] + self.command[:-1]), self.command[-1:]])


@dataclass(frozen=True)
class FinelyStepped(Stage):
    """A simulator and the lags and delays next to it, with several steps a tick; part of a started chain only."""

    ROLES: ClassVar[Role] = ExternalSimulator.ROLES
    stages: tuple[Stage, ...]
    steps: int

    def followed(self, stage: Stage) -> tuple[Stage, ...]:
        return (replace(self, stages=(*self.stages, stage)),) if stage.linear else (self, stage)

    def filter(self, sampling: Sampling) -> Filter:
        chain = Chain(self.stages)
        if sampling.hold != "zoh" or not sampling.first_tick:
            return chain.filter(sampling)
        return FinelySteppedFilter(chain.filter(replace(sampling, sample_time=sampling.sample_time / self.steps)), self.steps)


class FinelySteppedFilter(Filter):
    """Streaming `FinelyStepped`."""

    def __init__(self, running: Filter, steps: int) -> None:
        self.running, self.steps, self.hold = running, steps, running.hold

    def settle(self, value: Array) -> Array:
        return self.running.settle(value)

    def process(self, block: Array) -> Array:
        return self.running.process(np.repeat(block, self.steps, axis=0))[self.steps - 1 :: self.steps]


def external_simulator(simulate: Simulate, parameters: Mapping[str, Sequence[Any]]) -> tuple[ExternalSimulator, tuple[float, ...]]:
    """The stage of a simulator, and the standard deviations of its parameters, given as name: (value, deviation[, unit])."""
    if not callable(simulate):
        raise InputError(f"simulator: {simulate!r} cannot be called: give a function of command, sample_time and parameters")
    if not isinstance(parameters, Mapping):
        raise InputError('parameters: must be a mapping, such as {"stiffness": (1.2, 0.1, "N/um")}')
    values, deviations, units = [], [], []
    for name, given in parameters.items():
        try:
            value, deviation, *rest = given
            numbers = float(value), float(deviation)
            fits = isinstance(name, str) and len(rest) <= 1 and np.isfinite(numbers).all() and numbers[1] >= 0.0
        except (TypeError, ValueError):
            fits = False
        if not fits:
            raise InputError(f'parameters: {name}: {given!r}, must be value and standard deviation, such as (1.2, 0.1, "N/um")')
        values.append(numbers[0])
        deviations.append(numbers[1])
        units.append(str(rest[0]) if rest else "")
    return ExternalSimulator(simulate, tuple(parameters), tuple(values), tuple(units)), tuple(deviations)
