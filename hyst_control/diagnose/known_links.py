"""Outputs of the first filters of a chain, kept between simulations: candidates differ from the model in few stages."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Hashable, Sequence

from hyst_control.chain import Sampling, Stage
from hyst_control.chain.chain import arrange, links, resolved
from hyst_control.chain.stage import Array

MOST_BYTES = 64_000_000
"""Memory for the outputs that are kept; the one that was not asked for longest is dropped first."""


class KnownLinks:
    """Simulation of chains on one command, from the first filter that it has not run before.

    Parameters
    ----------
    command : ndarray, shape (N, A)
        V.
    most_bytes : int
        Memory for outputs.
    """

    def __init__(self, command: Array, most_bytes: int = MOST_BYTES) -> None:
        self.command = command
        self.most = max(most_bytes // max(command.nbytes, 1), 1)
        self.known: OrderedDict[Hashable, tuple[Array, Array]] = OrderedDict()

    def run(self, stages: Sequence[Stage], sampling: Sampling) -> tuple[Array, Array]:
        """Simulate stages from rest at the first command.

        Parameters
        ----------
        stages : sequence of Stage
            In signal order.
        sampling : Sampling
            Clock of the command.

        Returns
        -------
        settled : ndarray, shape (A,)
            Output at rest.
        output : ndarray, shape (N, A)
            Must not be changed: it is kept.

        Raises
        ------
        InputError
            Where a stage refuses its values.
        """
        value, output = self.command[0], self.command
        key: Hashable = ()
        keeps = True
        for link, running in links(arrange(resolved(stages, sampling.axes), sampling.hold), sampling):
            key = (key, link)
            found = None
            if keeps:
                try:
                    found = self.known.get(key)
                except TypeError:  # a stage of arrays, which are not compared
                    keeps = False
            if found is None:
                value = running.settle(value).copy()  # its own: processing may go on with it
                output = running.process(output)
                if keeps:
                    self.known[key] = value, output
                    if len(self.known) > self.most:
                        self.known.popitem(last=False)
            else:
                self.known.move_to_end(key)
                value, output = found
        return value, output

    def __getstate__(self) -> tuple[Array, int]:
        return self.command, self.most

    def __setstate__(self, state: tuple[Array, int]) -> None:
        self.command, self.most = state
        self.known = OrderedDict()
