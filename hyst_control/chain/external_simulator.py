# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A stage around a simulator that is a Python function of the whole command: what a diagnosis puts around other people's simulators.

    simulate(command, sample_time, **parameters) -> measurement

command[k] holds from tick k to tick k + 1, and measurement[k] is the sample at tick k, before command[k] acts. Arrays are (N,) for one
axis and (N, A) for several. A smooth command (`foh`) is held at its means between ticks; a function whose measurement[k] depends on
command[k] takes its samples instead. The stage is no part of the vocabulary of model files: a file that is read must not run functions
by name.

docs/any_simulator.md says when it is called at finer steps, and what the attribute `vectorized` is for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, ClassVar, TypeAlias

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.chain.bounded_cache import KEPT
from hyst_control.chain.chain import Chain
from hyst_control.chain.linear.linear_stages import Delay
from hyst_control.chain.parameter import Coordinate
from hyst_control.chain.stage import Filter, Modifier, Role, Sampling, Stage, ThroughFilter

Simulate: TypeAlias = Callable[..., Any]


def title_of(simulate: Simulate) -> str:
    """Name of a simulator for people."""
    return getattr(simulate, "__qualname__", type(simulate).__qualname__)


RECENT = 8  # Calls whose measurement is kept
RESTED = 64  # Samples of a call at rest: more than a function shifts its samples by
REST_TRIALS = 10  # Steps of the search for the command at which it rests
STEPS = 4  # Steps a tick of a function that can be called at finer ones
SAME = 1e-4  # Share of the range by which its samples may differ between both as they are
ALIKE = 1e-2  # The same where the difference on a held command is subtracted: integration errors of a step that follows the tick's
# How far half a tick of delay moves its samples, as a share of what a whole tick does: nothing, or all of it, where a sample follows from
# a single step, as of a gain. A delay of a part of a tick has no size there.
HALF_DELAY = (0.1, 0.9)


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
    differs: float = 0.0  # Share of the range by which its samples differ at finer steps; inf where it fails at these
    rest: tuple[float, ...] | None = None  # Command (A,) before the record; None: the first one
    holds_command: bool = False  # Whether it takes a smooth command held at its means
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
        """Behind the command at which all begins; with the lags and delays right before it within, if it can be called at finer steps."""
        if before and self.rest is not None:
            before = (BeginsAt(self.rest), *before)
        begin = len(before)
        while self._steps_finely and begin and (before[begin - 1].linear or isinstance(before[begin - 1], Delay)):
            begin -= 1
        if begin == len(before):
            return *before, self
        return *before[:begin], FinelyStepped((*before[begin:], self._inside), self.steps)

    @property
    def _steps_finely(self) -> bool:
        """True where lags and delays next to it are computed at finer steps; of a smooth command it is called at these anyway."""
        return self.steps > 1 and not self.holds_command

    @property
    def _inside(self) -> ExternalSimulator:
        """The same within `FinelyStepped`, which begins where all begins."""
        return replace(self, steps=1, rest=None)

    def stepped(self, command: Annotated[Array, "N A"], sample_time: float) -> ExternalSimulator:
        """The same with finer steps, if these give the same samples of a held command, and no sample follows from a single one."""
        fine = np.repeat(command, STEPS, axis=0)
        half = np.concatenate([fine[: STEPS // 2], fine[: -STEPS // 2]])
        whole = np.concatenate([command[:1], command[:-1]])
        expected = self.run(command, sample_time)
        try:
            held, late = (self.run(rows, sample_time / STEPS)[::STEPS] for rows in (fine, half))
        except InputError:
            return replace(self, differs=np.inf)
        differs = float(np.max(np.abs(held - expected)) / max(np.ptp(expected), 1e-300))
        moved, most = (float(np.linalg.norm(rows - expected)) for rows in (late, self.run(whole, sample_time)))
        parted = HALF_DELAY[0] * most <= moved <= HALF_DELAY[1] * most
        return replace(self, differs=differs, steps=STEPS if differs <= ALIKE and parted else 1)

    def begun(self, command: Annotated[Array, "N A"], sample_time: float) -> ExternalSimulator:
        """The same with the command before the record: the one at which the function stays where it begins."""
        expected = self.run(command, sample_time)
        still = SAME * float(np.ptp(expected))

        def motion(held: Annotated[Array, "A"]) -> Array:
            rows = self.run(np.repeat(held[None], len(command), axis=0), sample_time)
            moved: Array = (rows - rows[0]).reshape(-1)
            return moved

        def largest(held: Annotated[Array, "A"]) -> float:
            try:
                return float(np.max(np.abs(motion(held))))
            except InputError:
                return float(np.inf)

        from scipy.optimize import least_squares  # only here, it takes long to load

        zero, far = np.zeros(command.shape[1]), command[np.argmax(np.abs(command).sum(axis=1))]
        apart = np.max(np.abs(self.settled(far, sample_time) - self.settled(zero, sample_time)))
        if apart > still and largest(far) <= still:
            return self  # It begins at rest at any command
        held = min((zero, command[0]), key=largest)
        if largest(held) > still:
            with suppress(InputError):  # of a trial at which the function fails
                found = least_squares(motion, held, x_scale=np.max(np.abs(command), axis=0) + 1e-12, max_nfev=REST_TRIALS).x
                held = min((held, found), key=largest)
        return replace(self, rest=tuple(held.tolist()))

    def held(self, command: Annotated[Array, "N A"], sample_time: float) -> ExternalSimulator:
        """The same for a smooth command: held at its means, unless a sample depends on the command at its own tick."""
        other = command.copy()
        other[-1] += np.maximum(np.ptp(command, axis=0), 1.0)
        return replace(self, holds_command=bool(np.array_equal(*(self.run(rows, sample_time)[-1] for rows in (command, other)))))

    def settled(self, command: Annotated[Array, "A"], sample_time: float) -> Annotated[Array, "A"]:
        """Measurement at rest at a command."""
        key = (self.values, command.tobytes(), sample_time)
        if key not in self.resting:
            if len(self.resting) >= KEPT:
                self.resting.clear()
            self.resting[key] = self.run(np.repeat(command[None], RESTED, axis=0), sample_time)[0]
        return self.resting[key]

    def followed(self, stage: Stage) -> tuple[Stage, ...]:
        """With a lag behind it within, if it can be called at finer steps."""
        if not self._steps_finely or not stage.linear:
            return self, stage
        return (FinelyStepped((self._inside, stage), self.steps),)

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
        found = self.recent.pop(key, None)
        if found is None:
            found = self._called(command, sample_time, self.values)
            if len(self.recent) >= RECENT:
                self.recent.pop(next(iter(self.recent)))
        self.recent[key] = found  # The one that was not asked for longest is the first
        return found

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
        if not len(block):
            return block.copy()
        command, steps = self._held()
        return self.stage.run(command, self.sampling.sample_time / steps)[::steps][-len(block) :]

    def _held(self) -> tuple[Array, int]:
        """Command that the function holds, and its steps a tick: what is continuous is held at the means of these."""
        if not self.sampling.first_tick:
            steps = self.stage.steps
            return (held_at_means(self.command, steps), steps) if self.stage.holds_command else (self.command, 1)
        if self.sampling.hold == "zoh":
            return np.concatenate([self.command[1:], self.command[-1:]]), 1
        return held_at_means(self.command, 1), 1


def held_at_means(command: Annotated[Array, "N A"], steps: int) -> Annotated[Array, "M A"]:
    """A command that runs straight between ticks, as its means over the steps of each tick."""
    share = (np.arange(steps)[:, None] + 0.5) / steps
    ahead = np.concatenate([command[1:], command[-1:]])
    return (command[:, None] * (1.0 - share) + ahead[:, None] * share).reshape(-1, command.shape[1])


@dataclass(frozen=True)
class BeginsAt(Stage):
    """The command as it comes, behind another one that held before it; part of a started chain only."""

    rest: tuple[float, ...]

    def filter(self, sampling: Sampling) -> Filter:
        return BeginsAtFilter(self.rest, sampling.hold)


class BeginsAtFilter(ThroughFilter):
    """Streaming `BeginsAt`."""

    def __init__(self, rest: tuple[float, ...], hold: str) -> None:
        super().__init__(hold)
        self.rest = rest

    def settle(self, value: Array) -> Array:
        return np.array(self.rest)


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
        finer = replace(sampling, sample_time=sampling.sample_time / self.steps)
        alone = next(stage for stage in self.stages if isinstance(stage, ExternalSimulator))
        beside = (alone.filter(sampling), alone.filter(finer)) if alone.differs > SAME else None
        return FinelySteppedFilter(chain.filter(finer), self.steps, beside)


class FinelySteppedFilter(Filter):
    """Streaming `FinelyStepped`."""

    def __init__(self, running: Filter, steps: int, beside: tuple[Filter, Filter] | None) -> None:
        # beside: the function alone at the ticks and at finer steps; by what they differ on the held command the output is corrected
        self.running, self.steps, self.hold, self.beside = running, steps, running.hold, beside

    def settle(self, value: Array) -> Array:
        for alone in self.beside or ():
            alone.settle(value)
        return self.running.settle(value)

    def process(self, block: Array) -> Array:
        held, ends = np.repeat(block, self.steps, axis=0), slice(self.steps - 1, None, self.steps)
        output = self.running.process(held)[ends]
        if self.beside is None:
            return output
        coarse, fine = self.beside
        return output + coarse.process(block) - fine.process(held)[ends]


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
            fits = isinstance(name, str) and np.isfinite(numbers).all() and numbers[1] >= 0.0
            fits &= len(rest) <= 1 and all(isinstance(unit, str) for unit in rest)
        except (TypeError, ValueError):
            fits = False
        if not fits:
            raise InputError(
                f'parameters: {name}: {given!r}, must be value, standard deviation and a unit if any, such as (1.2, 0.1, "N/um")'
            )
        values.append(numbers[0])
        deviations.append(numbers[1])
        units.append(rest[0] if rest else "")
    return ExternalSimulator(simulate, tuple(parameters), tuple(values), tuple(units)), tuple(deviations)
