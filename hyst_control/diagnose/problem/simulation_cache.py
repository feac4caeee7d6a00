# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Outputs of the first filters of a chain and of its branches, kept between simulations: candidates differ from the model in few stages."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from typing import Annotated, NamedTuple

from hyst_control.base.arrays import Array
from hyst_control.chain import Sampling, Stage
from hyst_control.chain.chain import Link, Parallel, arrange, link_of, pieces, resolved, started_link

MAX_BYTES = 64_000_000  # Memory for the outputs that are kept; the one that was not asked for longest is dropped first


class Signal(NamedTuple):
    """A signal in a chain: its value (A,) at rest, its values (N, A), its hold, and its number; None for one that is not kept."""

    settled: Array
    values: Array
    hold: str
    number: int | None


class KnownLinks:
    """Simulation of chains on one command, from the first filter that it has not run before."""

    def __init__(self, command: Annotated[Array, "N A"], most_bytes: int = MAX_BYTES) -> None:
        self.command = command
        self.most = max(most_bytes // max(command.nbytes, 1), 1)
        self._forget()

    def _forget(self) -> None:
        self.known: OrderedDict[tuple[int, Link], Signal] = OrderedDict()
        self.count = 0

    def run(self, stages: Sequence[Stage], sampling: Sampling) -> tuple[Array, Array]:
        """Simulate stages from rest at the first command."""
        end = self._after(stages, Signal(self.command[0], self.command, sampling.hold, 0), sampling)
        return end.settled, end.values

    def _after(self, stages: Sequence[Stage], signal: Signal, sampling: Sampling) -> Signal:
        """The signal behind stages in series."""
        for piece in pieces(arrange(resolved(stages, sampling.axes), sampling.hold)):
            sampling = sampling.with_hold(signal.hold)
            signal = self._recalled(link_of(piece, sampling), signal)
        return signal

    def _recalled(self, link: Link, signal: Signal) -> Signal:
        """The signal behind a link."""
        if signal.number is None:
            return self._run(link, signal)
        key = signal.number, link
        try:
            found = self.known.get(key)
        except TypeError:  # a stage of arrays, which are not compared
            return self._run(link, signal)
        if found is not None:
            self.known.move_to_end(key)
            return found
        found = self._run(link, signal)
        self.count += 1
        found = found._replace(number=self.count)
        self.known[key] = found
        if len(self.known) > self.most:
            self.known.popitem(last=False)
        return found

    def _run(self, link: Link, signal: Signal) -> Signal:
        stages, _, sampling = link
        if isinstance(stages[0], Parallel):
            ends = [self._after(branch, signal, sampling) for branch in stages[0].branches]
            settled, values = ends[0].settled, ends[0].values
            for end in ends[1:]:
                settled, values = settled + end.settled, values + end.values
            return Signal(settled, values, "zoh" if all(end.hold == "zoh" for end in ends) else "foh", None)
        running = started_link(link)
        settled = running.settle(signal.settled).copy()  # its own: processing may go on with it
        return Signal(settled, running.process(signal.values), running.hold, None)

    def __getstate__(self) -> tuple[Array, int]:
        return self.command, self.most

    def __setstate__(self, state: tuple[Array, int]) -> None:
        self.command, self.most = state
        self._forget()
