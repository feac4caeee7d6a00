"""Chains that differ in few parameters, run side by side; equal parts are computed once.

A derivative by differences needs a chain per parameter, but a parameter changes one stage. Chains whose first stages are equal
share their output, and so do equal branches of parallel stages.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from hyst_control.chain import Filter, Parallel, Sampling, Stage
from hyst_control.chain.chain import arrange, resolved, started
from hyst_control.chain.linear import Delay
from hyst_control.chain.stage import Array

SOURCE = -1
"""Number of the signal that enters all chains."""


@dataclass(frozen=True)
class Node:
    """One step of some chains: a filter behind another node, or the sum of several nodes.

    Parameters
    ----------
    before
        Numbers of the nodes whose outputs enter.
    running
        The filter; None for a sum.
    hold
        Hold of the output, "zoh" or "foh".
    """

    before: tuple[int, ...]
    running: Filter | None
    hold: str


class Bundle:
    """Running chains of one axis with a common input.

    The outputs are those of each chain run by itself, with the same two calls.

    Parameters
    ----------
    chains
        Stages of every chain.
    sampling
        Sample time and hold of the input.
    """

    def __init__(self, chains: Sequence[Sequence[Stage]], sampling: Sampling) -> None:
        self.nodes: list[Node] = []
        self._sampling = sampling
        self._known: dict[tuple[object, ...], int] = {}
        self._filters: dict[tuple[tuple[Stage, ...], str], Filter] = {}
        self.outputs = [self._series(arrange(resolved(stages, 1), sampling.hold), SOURCE) for stages in chains]

    def settle(self, value: float) -> None:
        """Come to rest at a constant input.

        Parameters
        ----------
        value
            The input.
        """
        signals: list[Array] = []
        for node in self.nodes:
            inputs = [np.full(1, value) if number == SOURCE else signals[number] for number in node.before]
            signals.append(node.running.settle(inputs[0]) if node.running else np.sum(inputs, axis=0))

    def process(self, block: Array) -> list[Array]:
        """Compute the chains' outputs for the next block of the input.

        Parameters
        ----------
        block
            Input (N, 1), which continues the block before.

        Returns
        -------
        list[Array]
            An output (N,) a chain; equal chains have the same array.
        """
        signals: list[Array] = []
        for node in self.nodes:
            inputs = [block if number == SOURCE else signals[number] for number in node.before]
            signals.append(node.running.process(inputs[0]) if node.running else sum(inputs[1:], start=inputs[0]))
        return [(block if number == SOURCE else signals[number])[:, 0] for number in self.outputs]

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
        return self._node(("sum", *ends), Node(ends, None, hold))

    def _filtered(self, run: tuple[Stage, ...], before: int) -> int:
        if (run, before) in self._known:
            return self._known[run, before]
        hold = self._hold(before)
        if (run, hold) not in self._filters:
            self._filters[run, hold] = started(run, self._sampling.with_hold(hold))
        running = deepcopy(self._filters[run, hold])
        return self._node((run, before), Node((before,), running, running.hold))

    def _node(self, key: tuple[object, ...], node: Node) -> int:
        if key not in self._known:
            self._known[key] = len(self.nodes)
            self.nodes.append(node)
        return self._known[key]
