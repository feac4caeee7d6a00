# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Simulations that go on from what is known equal those from the beginning."""

import pickle

import numpy as np

from hyst_control.chain import Chain, Sampling
from hyst_control.chain.chain import Parallel
from hyst_control.chain.hysteresis.prandtl_ishlinskii import PlayFilter, PlayOperator
from hyst_control.chain.linear.linear_filter import LinearFilter
from hyst_control.chain.linear.linear_stages import Delay, TransferFunction
from hyst_control.chain.memoryless import Gain, Offset
from hyst_control.diagnose.problem.per_record_stages import ErrorBasis, LearnedError
from hyst_control.diagnose.problem.simulation_cache import KnownLinks

COMMAND = 3.0 * np.cumsum(np.random.default_rng(1).standard_normal((400, 1)), axis=0)
SLOW, FAST = TransferFunction((2.0,), (0.01, 1.0)), TransferFunction((1.0,), (1e-7, 1e-4, 1.0))
CHAINS = [
    (Gain(2.0), SLOW),
    (Gain(2.0), SLOW, Offset(1.0)),
    (Gain(2.0), SLOW, Offset(2.0)),
    (Gain(3.0), SLOW, Offset(2.0)),
    (Delay(1.3e-4), Gain(2.0), SLOW, FAST, Offset(2.0)),
    (Parallel(((Gain(1.0), FAST), (SLOW,))), Offset(2.0)),
    (Gain(2.0), SLOW),
]


def from_the_beginning(stages, sampling):
    running = Chain(stages).filter(sampling)
    return running.settle(COMMAND[0]), running.process(COMMAND)


def test_equal_to_a_simulation_from_the_beginning() -> None:
    for most in (64_000_000, 2 * COMMAND.nbytes):  # all is kept, or next to nothing
        links = KnownLinks(COMMAND, most)
        for stages in CHAINS:
            for sampling in (Sampling(1e-4, 1, "zoh"), Sampling(1e-4, 1, "foh"), Sampling(2e-4, 1, "zoh")):
                for found, due in zip(links.run(stages, sampling), from_the_beginning(stages, sampling), strict=True):
                    np.testing.assert_array_equal(found, due)
        assert len(links.known) <= most // COMMAND.nbytes


def test_only_what_is_new_is_run(monkeypatch) -> None:
    runs = []
    process = LinearFilter.process
    monkeypatch.setattr(LinearFilter, "process", lambda self, block: runs.append(1) or process(self, block))
    links, sampling = KnownLinks(COMMAND), Sampling(1e-4, 1, "zoh")
    for stages in CHAINS[:3]:
        links.run(stages, sampling)
    assert len(runs) == 1


def test_a_branch_that_stays_is_not_run_again(monkeypatch) -> None:
    """A hysteresis beside a linear branch: another linear stage behind both leaves the hysteresis' own output as it was."""
    runs = []
    for kind in (LinearFilter, PlayFilter):

        def counted(self, block, process=kind.process):
            runs.append((type(self), len(block)))
            return process(self, block)

        monkeypatch.setattr(kind, "process", counted)
    play, sampling, links = PlayOperator(1.0), Sampling(1e-4, 1, "zoh"), KnownLinks(COMMAND)
    linear, hysteresis = (LinearFilter, len(COMMAND)), (PlayFilter, len(COMMAND))
    for beside, behind, due in (
        (SLOW, FAST, [hysteresis, linear, linear]),
        (SLOW, SLOW, [linear, linear]),  # it is merged with the linear branch, and follows the hysteresis
        (FAST, SLOW, [linear]),
    ):
        stages = (Parallel(((play,), (beside,))), behind)
        runs.clear()
        found = links.run(stages, sampling)
        assert [run for run in runs if run[1] > 1] == due
        for one, other in zip(found, from_the_beginning(stages, sampling), strict=True):
            np.testing.assert_array_equal(one, other)


def test_nothing_is_kept_in_a_pickle() -> None:
    links = KnownLinks(COMMAND)
    links.run(CHAINS[0], Sampling(1e-4, 1, "zoh"))
    assert not pickle.loads(pickle.dumps(links)).known


def test_stages_of_whole_series_are_told_apart() -> None:
    """A predicted error holds its series beside its declared fields: two of them are equal only if they are one."""

    def predicted(sign: float) -> LearnedError:
        return LearnedError(np.ones(1), ErrorBasis((sign * COMMAND,)))

    assert predicted(1.0) != predicted(1.0)
    links, sampling = KnownLinks(COMMAND), Sampling(1e-4, 1, "zoh")
    for sign in (1.0, -1.0):
        stages = (SLOW, predicted(sign).for_record(0))
        np.testing.assert_array_equal(links.run(stages, sampling)[1], from_the_beginning(stages, sampling)[1])
