# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Chains: stages in signal order, and stages in parallel.

Starting a chain first *arranges* it, which changes nothing in continuous time and makes the sampled result exact: delays move to the
nearest linear stage, linear stages into parallel branches, and neighboring linear stages merge (docs/architecture.md). A lag of a held
signal in front of a hysteresis (`effects.amplifier_lowpass`) bends it between the samples, and the hysteresis' output alike: it is
followed at the samples, and bent on the way to what is linear behind.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import groupby
from typing import ClassVar, cast

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.chain.c_code.c_code import CCode, parallel, series
from hyst_control.chain.linear.linear_stages import Delay, linear_filter
from hyst_control.chain.memoryless import Gain, Offset
from hyst_control.chain.parameter import chains
from hyst_control.chain.stage import Filter, Modifier, Sampling, Stage, register

Piece = tuple[tuple[Stage, ...], bool]
"""Stages of one filter of a chain, and whether what follows them shall see a held signal held at its means."""
Link = tuple[tuple[Stage, ...], bool, Sampling]
"""Stages of one filter of a chain, whether its output is held at its means, and its clock: equal links have equal filters."""


@dataclass(frozen=True)
class Chain:
    """Stages in signal order."""

    stages: tuple[Stage, ...]

    def filter(self, sampling: Sampling) -> Filter:
        """Start a filter of the whole chain for the clock `sampling`."""
        return started(arrange(resolved(self.stages, sampling.axes), sampling.hold), sampling)


def resolved(stages: Sequence[Stage], axes: int) -> tuple[Stage, ...]:
    """The stages, in signal order, with every modifier applied to those before it."""
    result: tuple[Stage, ...] = ()
    for stage in stages:
        if isinstance(stage, Modifier):
            result = stage.applied(result, axes)
        else:
            result = (*result[:-1], *result[-1].followed(stage)) if result else (stage,)
    return result


class SeriesFilter(Filter):
    """Filters one after the other."""

    def __init__(self, filters: list[Filter], hold: str) -> None:
        self.filters = filters
        self.hold = hold

    def settle(self, value: Array) -> Array:
        for running in self.filters:
            value = running.settle(value)
        return value

    def process(self, block: Array) -> Array:
        for running in self.filters:
            block = running.process(block)
        return block

    def c_code(self) -> CCode:
        return series([running.c_code() for running in self.filters])


class Averaged(ABC):
    """A stage that bends the held command within a sample: what follows gets the samples it ends at, or the mean over each."""

    @abstractmethod
    def at_samples(self) -> Stage:
        """Stage that the samples go through."""

    @abstractmethod
    def between_samples(self) -> tuple[Stage, ...]:
        """Stages that bend the way from one sample to the next."""


class ParallelFilter(Filter):
    """Filters fed alike, outputs added."""

    def __init__(self, filters: list[Filter]) -> None:
        self.filters = filters
        self.hold = "zoh" if all(running.hold == "zoh" for running in filters) else "foh"

    def settle(self, value: Array) -> Array:
        return reduce(np.add, [running.settle(value) for running in self.filters])

    def process(self, block: Array) -> Array:
        return reduce(np.add, [running.process(block) for running in self.filters])

    def c_code(self) -> CCode:
        return parallel([running.c_code() for running in self.filters])


@register
@dataclass(frozen=True)
class Parallel(Stage):
    """Branches fed alike, outputs added. MHL's H_D is `madelung` in parallel with `rate_correction` (MHL paper Eq. 3)."""

    name: ClassVar[str] = "parallel"
    equation: ClassVar[str] = r"y = \sum_i C_i[u], \quad C_i \text{ the chains of } \mathrm{branches}"
    branches: tuple[tuple[Stage, ...], ...] = chains("fed alike, outputs added")

    def check(self) -> None:
        if not self.branches:
            raise InputError("branches: is empty, at least one chain is needed")

    @property
    def inner_chains(self) -> tuple[tuple[Stage, ...], ...]:
        return self.branches

    def with_inner_chains(self, chains: Sequence[Sequence[Stage]]) -> Parallel:
        return Parallel(tuple(tuple(chain) for chain in chains))

    @property
    def _members(self) -> Iterator[Stage]:
        return (member for branch in self.branches for member in branch)

    @property
    def commutes_with_delay(self) -> bool:
        return all(member.commutes_with_delay for member in self._members)

    @property
    def mixes_axes(self) -> bool:
        return any(member.mixes_axes for member in self._members)

    @property
    def is_hysteresis(self) -> bool:
        return any(member.is_hysteresis for member in self._members)

    @property
    def has_compensator(self) -> bool:
        return any(member.has_compensator for member in self._members)

    def at_rest(self, signal: Array) -> Array:
        return cast(Array, np.sum([at_rest(branch, signal) for branch in self.branches], axis=0))

    def filter(self, sampling: Sampling) -> Filter:
        return started((self,), sampling)


def at_rest(stages: Sequence[Stage], signal: Array) -> Array:
    """Output of stages in a row without rates, delays and dynamics: every value is held until all has settled, from rest at 0."""
    for stage in stages:
        signal = stage.at_rest(signal)
    return signal


def started(stages: Sequence[Stage], sampling: Sampling) -> Filter:
    """A filter for stages that are arranged already, not yet settled; the clock is that of the first of them."""
    filters: list[Filter] = []
    for piece in pieces(stages):
        running = started_link(link_of(piece, sampling))
        filters.append(running)
        sampling = sampling.with_hold(running.hold)
    return filters[0] if len(filters) == 1 else SeriesFilter(filters, sampling.hold)


def pieces(stages: Sequence[Stage]) -> list[Piece]:
    """Cut stages that are arranged already where one filter ends and the next one begins."""
    runs = [(linear, list(group)) for linear, group in groupby(stages, key=_in_linear_run)]
    return [
        (tuple(piece), linear and number + 1 < len(runs) and _averaged(piece, runs[number + 1][1][0]))
        for number, (linear, run) in enumerate(runs)
        for piece in (_cut_before_uneven_delays(run) if linear else [[stage] for stage in run])
    ]


def link_of(piece: Piece, sampling: Sampling) -> Link:
    """Tell all that the filter of a piece is made of: equal for pieces that need the same filter."""
    stages, averaged = piece
    return stages, averaged and sampling.hold == "zoh", sampling


def started_link(link: Link) -> Filter:
    """Start the filter of a link, not yet settled."""
    stages, averaged, sampling = link
    if _in_linear_run(stages[0]):
        return linear_filter(list(stages), sampling, averaged)
    if isinstance(stages[0], Parallel):
        return ParallelFilter([Chain(branch).filter(sampling) for branch in stages[0].branches])
    return stages[0].filter(sampling)


def arrange(stages: Sequence[Stage], hold: str = "foh") -> tuple[Stage, ...]:
    """The same chain with its delays where a linear stage carries them, and linear stages inside the branches before them."""
    placed = _place_delays(stages)
    return _distribute(_pass_bends(placed) if hold == "zoh" else placed)


def _pass_bends(stages: Sequence[Stage]) -> list[Stage]:
    """Take what a lag does between the samples over the memory that follows it, to the next linear stage or into branches."""
    # Where nothing linear follows, the samples are all that is seen. A stage with dynamics of its own gets the mean instead.
    passed: list[Stage] = []
    waiting: tuple[Stage, ...] = ()
    for index, stage in enumerate(stages):
        following = next((other for other in stages[index + 1 :] if not isinstance(other, Delay)), None)
        bends = isinstance(stage, Averaged) and not any(_is_system(before) for before in passed)
        ends = following is None or _is_system(following) or following.mixes_axes
        if bends and isinstance(following, Parallel):
            waiting = (*waiting, stage)
        elif bends and isinstance(stage, Averaged) and not ends:
            passed.append(stage.at_samples())
            waiting = (*waiting, *stage.between_samples())
        elif waiting and isinstance(stage, Parallel):
            passed.append(Parallel(tuple((*waiting, *branch) for branch in stage.branches)))
            waiting = ()
        elif waiting and (_is_system(stage) or stage.mixes_axes):
            passed += [*waiting, stage]
            waiting = ()
        elif waiting and isinstance(stage, Delay):
            waiting = (*waiting, stage)
        else:
            passed.append(stage)
    return [*passed, *(stage for stage in waiting if isinstance(stage, Delay))]


def _is_system(stage: Stage) -> bool:
    return _in_linear_run(stage) and not isinstance(stage, Delay)


def _in_linear_run(stage: Stage) -> bool:
    return isinstance(stage, Delay) or stage.linear


def _averaged(run: Sequence[Stage], following: Stage) -> bool:
    """True where a stage that follows a run of a held signal shall see it held at its means (see `effects.amplifier_lowpass`)."""
    systems = [stage for stage in run if not isinstance(stage, Delay)]
    return all(isinstance(stage, Averaged) for stage in systems) if systems else following.sees_means


def _carries_delay(stage: Stage) -> bool:
    # A mean is taken over the intervals of the command: a delay waits until behind it.
    return isinstance(stage, Parallel) or (_in_linear_run(stage) and not isinstance(stage, Averaged))


def _place_delays(stages: Sequence[Stage]) -> list[Stage]:
    placed: list[Stage] = []
    waiting: list[Stage] = []
    for stage in stages:
        if isinstance(stage, Delay):
            waiting.append(stage)
            continue
        if waiting and isinstance(stage, Parallel):
            stage = Parallel(tuple((*waiting, *branch) for branch in stage.branches))
            waiting = []
        elif waiting and (_carries_delay(stage) or not _commutes(stage, waiting)):
            placed.extend(waiting)
            waiting = []
        placed.append(stage)
    if not waiting:
        return placed
    # Nothing linear followed: go back to the last linear stage, over stages that let a delay pass.
    for index in range(len(placed) - 1, -1, -1):
        stage = placed[index]
        if not _commutes(stage, waiting):
            break
        if isinstance(stage, Parallel):
            placed[index] = Parallel(tuple((*waiting, *branch) for branch in stage.branches))
            return placed
        if _carries_delay(stage):
            return placed[:index] + waiting + placed[index:]
    return placed + waiting


def _commutes(stage: Stage, delays: Sequence[Stage]) -> bool:
    """True where the delays may change places with a stage: not one that mixes the axes, where they differ between the axes."""
    return stage.commutes_with_delay and (_even(delays) or not stage.mixes_axes)


def _even(delays: Sequence[Stage]) -> bool:
    return all(
        not isinstance(delay, Delay) or np.ndim(delay.tau) == 0 or len(set(cast(Sequence[float], delay.tau))) == 1
        for delay in delays
    )


def _cut_before_uneven_delays(run: Sequence[Stage]) -> list[list[Stage]]:
    """A run takes its delays at its input: one that differs between the axes starts a new run behind a stage that mixes them."""
    pieces: list[list[Stage]] = [[]]
    for stage in run:
        if isinstance(stage, Delay) and not _even([stage]) and any(before.mixes_axes for before in pieces[-1]):
            pieces.append([])
        pieces[-1].append(stage)
    return pieces


def _gains_last(stages: Sequence[Stage]) -> list[Stage]:
    """Stages in which a gain or an offset changes places with a linear stage behind it that it would part from those before."""
    ordered = list(stages)
    for index in range(1, len(ordered) - 1):
        before, static, after = ordered[index - 1 : index + 2]
        in_between = isinstance(before, Parallel) or _in_linear_run(before)
        commutes = isinstance(static, Gain) or isinstance(static, Offset) and after.unit_gain
        if in_between and commutes and _in_linear_run(after) and not after.mixes_axes:
            ordered[index], ordered[index + 1] = after, static
    return ordered


def _distribute(stages: list[Stage]) -> tuple[Stage, ...]:
    arranged: list[Stage] = []
    for stage in _gains_last(stages):
        if arranged and isinstance(arranged[-1], Parallel) and _in_linear_run(stage):
            arranged[-1] = Parallel(tuple((*branch, stage) for branch in arranged[-1].branches))
        else:
            arranged.append(stage)
    return tuple(arranged)
