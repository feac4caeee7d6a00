# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Chains that differ in few parameters, run side by side; equal parts are computed once.

A derivative by differences needs a chain per parameter, but a parameter changes one stage. Chains whose first stages are equal
share their output, and so do equal branches of parallel stages. What is linear and of the same order runs side by side.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass
from itertools import groupby
from typing import Annotated, TypeGuard

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.chain import Filter, Parallel, Sampling, Stage
from hyst_control.chain.chain import arrange, resolved, started
from hyst_control.chain.linear.linear_filter import LinearFilter
from hyst_control.chain.linear.linear_lanes import LinearLanes
from hyst_control.chain.linear.linear_stages import Delay, Discretised

SOURCE = -1  # Number of the signal that enters all chains, which stands behind those of all nodes
NEGLIGIBLE = 1e-9  # Share of its largest value below which a free motion has died away
TOGETHER = 512  # Rows of a free motion that are computed from others at once


@dataclass(frozen=True)
class Node:
    """One step of some chains: a filter behind another node, or the sum of several nodes."""

    before: tuple[int, ...]  # Numbers of the nodes whose outputs enter
    running: Filter | None  # The filter; None for a sum
    hold: str  # Hold of the output, "zoh" or "foh"
    depth: int  # Number of nodes in a row that come before it


class Bundle:
    """Running chains of one axis with a common input.

    The outputs are those of each chain run by itself, with the same two calls.
    """

    def __init__(self, chains: Sequence[Sequence[Stage]], sampling: Sampling) -> None:
        self.nodes: list[Node] = []
        self._sampling = sampling
        self._known: dict[tuple[object, ...], int] = {}
        self._filters: dict[tuple[tuple[Stage, ...], str], Filter] = {}
        self.outputs = [self._series(arrange(resolved(stages, 1), sampling.hold), SOURCE) for stages in chains]
        self._steps = [(numbers, self._run(numbers)) for numbers in alike(self.nodes)]

    def settle(self, value: float) -> Array:
        """Come to rest at a constant input; returns the chains' outputs there."""
        signals: list[Array] = [np.empty(0)] * len(self.nodes) + [np.full(1, value)]
        for numbers, running in self._steps:
            inputs = [[signals[before] for before in self.nodes[number].before] for number in numbers]
            if isinstance(running, LinearLanes):
                settled = running.settle(np.array([each[0][0] for each in inputs]))
                for number, end in zip(numbers, settled, strict=True):
                    signals[number] = np.full(1, end)
            else:
                signals[numbers[0]] = running.settle(inputs[0][0]) if running else sum(inputs[0][1:], start=inputs[0][0])
        return np.array([signals[number][0] for number in self.outputs])

    def process(self, block: Annotated[Array, "N 1"]) -> list[Array]:
        """Compute the chains' outputs for the next block of the input."""
        signals: list[Array] = [np.empty(0)] * len(self.nodes) + [block[:, 0]]
        for numbers, running in self._steps:
            inputs = [[signals[before] for before in self.nodes[number].before] for number in numbers]
            if isinstance(running, LinearLanes):
                for number, signal in zip(numbers, running.process([each[0] for each in inputs]), strict=True):
                    signals[number] = signal
            else:
                ends = inputs[0]
                signals[numbers[0]] = running.process(ends[0][:, None])[:, 0] if running else sum(ends[1:], start=ends[0])
        return [signals[number] for number in self.outputs]

    @property
    def states(self) -> int:
        """Number of states of the dynamics that end the first chain; 0 where it ends otherwise."""
        return self.free_motions().states

    def free_motions(self) -> FreeMotions:
        """The free motions of the dynamics that end the chains, filters or sums of filters."""
        chains = [self._parts(number) for number in self.outputs]
        running = {number: self.nodes[number].running for number in {part for parts in chains for part in parts}}
        return FreeMotions({number: Decay(each.a[0], each.c[0, 0]) for number, each in running.items() if single(each)}, chains)

    def _parts(self, number: int) -> tuple[int, ...]:
        """Filters whose sum a chain ends with; none where it ends otherwise."""
        if number == SOURCE:
            return ()
        node = self.nodes[number]
        parts = (number,) if node.running else node.before
        return parts if all(part != SOURCE and single(self.nodes[part].running) for part in parts) else ()

    def _run(self, numbers: Sequence[int]) -> LinearLanes | Filter | None:
        """Filter of a step's nodes: linear nodes run side by side, any other node by itself."""
        filters = [self.nodes[number].running for number in numbers]
        linear = [each for each in filters if single(each)]
        if not linear:
            return filters[0]
        systems = [Discretised(each.a[0], each.b[0], each.c[0], each.d[0], each.bias) for each in linear]
        return LinearLanes(systems, [int(each.whole[0]) for each in linear])

    def _series(self, stages: Sequence[Stage], before: int) -> int:
        """Number of the node that ends stages in series; adjacent linear stages are one filter, as in a chain."""
        for linear, group in groupby(stages, key=lambda stage: stage.linear or isinstance(stage, Delay)):
            for run in [tuple(group)] if linear else [(stage,) for stage in group]:
                if isinstance(run[0], Parallel):
                    ends = tuple(self._series(arrange(branch, self._hold(before)), before) for branch in run[0].branches)
                    before = self._sum(ends)
                else:
                    before = self._filtered(run, before)
        return before

    def _hold(self, number: int) -> str:
        return self._sampling.hold if number == SOURCE else self.nodes[number].hold

    def _sum(self, ends: tuple[int, ...]) -> int:
        hold = "zoh" if all(self._hold(end) == "zoh" for end in ends) else "foh"
        return self._node(("sum", *ends), Node(ends, None, hold, self._depth(ends)))

    def _depth(self, before: Sequence[int]) -> int:
        return 1 + max((self.nodes[number].depth for number in before if number != SOURCE), default=-1)

    def _filtered(self, run: tuple[Stage, ...], before: int) -> int:
        if (run, before) in self._known:
            return self._known[run, before]
        hold = self._hold(before)
        if (run, hold) not in self._filters:
            self._filters[run, hold] = started(run, self._sampling.with_hold(hold))
        running = self._filters[run, hold]
        running = running if single(running) else deepcopy(running)
        return self._node((run, before), Node((before,), running, running.hold, self._depth((before,))))

    def _node(self, key: tuple[object, ...], node: Node) -> int:
        if key not in self._known:
            self._known[key] = len(self.nodes)
            self.nodes.append(node)
        return self._known[key]


class Decay:
    """Free motion of a linear system: what each of its states (n,), 1 at the beginning, adds to the output row by row."""

    def __init__(self, transition: Array, output: Array) -> None:
        self._transition, self._row = np.ascontiguousarray(transition), np.array(output, dtype=float)
        self.first = self._row @ self._transition
        self._largest = np.abs(self._row)  # By state, as each has a unit of its own
        self.states = len(transition)

    @property
    def is_over(self) -> bool:
        """True where nothing is left of the motion."""
        return not np.any(self._row)

    def rows(self, count: int) -> Array:
        """The next `count` rows (count, n): the rows known so far times a power of the transition are as many again."""
        found = np.zeros((count, self.states))
        if self.is_over or not count:
            return found
        found[0], power, known = self._row @ self._transition, self._transition, 1
        while known < count:
            step = min(known, TOGETHER)
            more = min(step, count - known)
            np.matmul(found[known - step : known - step + more], power, out=found[known : known + more])
            known += more
            power = power @ power if step < TOGETHER else power
        self._largest = np.maximum(self._largest, np.abs(found[:TOGETHER]).max(axis=0))  # a motion is largest at first
        alive = np.any(np.abs(found[-1]) > NEGLIGIBLE * self._largest)
        self._row = found[-1] if alive else np.zeros(self.states)
        return found


class FreeMotions:
    """Free motions of the dynamics that end chains side by side, state by state; those of parts that chains share are computed once."""

    def __init__(self, decays: Mapping[int, Decay], chains: Sequence[Sequence[int]]) -> None:
        # decays: of every part; chains: parts of each chain, the nominal one first
        self._decays, self._nominal, self._others = decays, chains[0], chains[1:]
        parts = [decays[number] for number in self._nominal]
        self.first = np.concatenate([np.zeros(0), *(part.first for part in parts)])
        self.states = len(self.first)

    @property
    def is_over(self) -> bool:
        """True where nothing is left of the nominal chain's motions."""
        return all(self._decays[number].is_over for number in self._nominal)

    def rows(self, count: int, state: Array) -> tuple[Array, Array]:
        """The next `count` rows of the nominal chain (count, n), and by how much those of others differ from an initial state (n,)."""
        rows = {number: decay.rows(count) for number, decay in self._decays.items()}
        others = self._others if len(state) else []
        moved = np.zeros((count, len(others)), order="F")
        for column, parts in zip(moved.T, others, strict=True):
            at = 0
            for number, part in zip(self._nominal, parts, strict=True):
                own = state[at : at + self._decays[number].states]
                if part != number:
                    column += (rows[part] - rows[number]) @ own
                at += len(own)
        return np.column_stack([rows[number] for number in self._nominal]), moved


def alike(nodes: Sequence[Node]) -> list[list[int]]:
    """Order nodes so that they can be run; linear systems of one depth and order are one step."""
    steps: dict[tuple[int, ...], list[int]] = {}
    for number, node in enumerate(nodes):
        running = node.running
        key = (node.depth, 0, running.a.shape[1]) if single(running) else (node.depth, 1, number)
        steps.setdefault(key, []).append(number)
    return [steps[key] for key in sorted(steps)]


def single(running: Filter | None) -> TypeGuard[LinearFilter]:
    """Tell a filter of one linear system of one input from others."""
    return isinstance(running, LinearFilter) and running.a.shape[0] == 1 and running.c.shape[1] == 1
