# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Chains run side by side against each chain by itself."""

import numpy as np
import pytest
from scipy.linalg import block_diag, expm

from hyst_control.chain import Chain, Parallel, Sampling
from hyst_control.chain.hysteresis.madelung import Madelung
from hyst_control.chain.linear.linear_stages import Delay, RateCorrection, StateSpace, TransferFunction
from hyst_control.chain.memoryless import Gain, Offset
from hyst_control.identify.solve.chain_batch import Bundle, Decay

SLOW, FAST = TransferFunction([1.0], [1e-3, 1.0]), TransferFunction([2.0], [1e-8, 1e-4, 1.0])


def loop(bulge: float) -> Madelung:
    """Hysteresis between two parabolas."""
    return Madelung([bulge, 1.0 - bulge], [-bulge, 1.0 + bulge], 100.0, 2.0)


def mhl(bulge: float, k1: float, dynamics: TransferFunction) -> tuple[object, ...]:
    """Delay, hysteresis beside a rate correction, dynamics."""
    return Delay(68e-6), Parallel(((loop(bulge),), (RateCorrection(k1=k1, k2=1e-3, b1=0.1),))), dynamics


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_every_chain_gives_the_same_numbers_as_alone(hold: str) -> None:
    """Chains equal in their beginnings, their branches, wholly or not at all; two settles and uneven blocks, as records come."""
    chains = [
        mhl(0.1, 1e-6, SLOW),
        mhl(0.2, 1e-6, SLOW),
        mhl(0.1, 2e-6, SLOW),
        mhl(0.1, 1e-6, FAST),
        mhl(0.1, 1e-6, SLOW),
        (Gain(2.0), SLOW, FAST),
        (Gain(2.0), SLOW, Offset(1.0)),
        (loop(0.1), Delay(1e-4)),
        (),
    ]
    sampling = Sampling(5e-5, 1, hold)
    bundle, alone = Bundle(chains, sampling), [Chain(chain).filter(sampling) for chain in chains]
    rng = np.random.default_rng(1)
    for start in (0.0, 30.0):
        signal = np.clip(start + np.cumsum(rng.normal(0.0, 3.0, 900)), 0.0, 100.0)[:, None]
        bundle.settle(float(signal[0, 0]))
        for running in alone:
            running.settle(signal[0])
        for part in (signal[:1], signal[1:400], signal[400:]):
            for found, running in zip(bundle.process(part), alone, strict=True):
                np.testing.assert_allclose(found, running.process(part)[:, 0], rtol=0, atol=1e-13)  # of 2


def test_what_chains_share_is_run_once() -> None:
    """Neighbors in one parameter of curves, rate part and dynamics: 2 loops, 2 of G behind them for each, 3 rate parts with G."""
    chains = [mhl(0.1, 1e-6, SLOW), mhl(0.2, 1e-6, SLOW), mhl(0.1, 2e-6, SLOW), mhl(0.1, 1e-6, FAST)]
    filters = [node for node in Bundle(chains, Sampling(5e-5, 1, "zoh")).nodes if node.running is not None]
    loops = [node for node in filters if type(node.running).__name__ == "MadelungFilter"]
    assert len(loops) == 2
    assert len(filters) == 2 + 3 + 3


def test_free_motions_of_parts_side_by_side_are_those_of_each_by_itself() -> None:
    """A sum whose parts are shared with its neighbors: each state's motion, and what another frequency changes of a given one."""
    turn, lag = np.array([[0.0, 300.0], [-300.0, -20.0]]), StateSpace([[-50.0]], [[50.0]], [[2.0]], [[0.0]])

    def mode(factor: float) -> StateSpace:
        return StateSpace(factor * turn, [[0.0], [300.0]], [[1.0, 0.1]], [[0.0]])

    step, late, state = 1e-3, Delay(1.3e-3), np.array([0.3, -2.0, 0.7])
    chains = [(Parallel(((late, mode(factor)), (late, lag))),) for factor in (1.0, 1.01, 1.0)]
    motions = Bundle(chains, Sampling(step, 1, "zoh")).free_motions()
    rows = [motions.rows(count, state) for count in (30, 700)]
    free, moved = (np.vstack([part[number] for part in rows]) for number in range(2))

    def alone(factor: float) -> np.ndarray:
        both = block_diag(factor * turn, [[-50.0]])
        return np.array([np.array([1.0, 0.1, 2.0]) @ expm(both * step * row) for row in range(1, 731)])

    units = np.linalg.lstsq(alone(1.0)[:3], free[:3], rcond=None)[0]  # the states that a filter runs in are others
    np.testing.assert_allclose(free, alone(1.0) @ units, atol=1e-12)
    assert motions.states == 3 and moved.shape == (730, 2) and not moved[:, 1].any()
    np.testing.assert_allclose(moved[:, 0], (alone(1.01) - alone(1.0)) @ units @ state, atol=1e-11)


def test_free_motion_is_that_of_powers_of_the_transition_in_any_units_of_the_states() -> None:
    """Two states that act on each other, in units a billionth of each other's; the rows come in two blocks."""
    turned = np.array([[0.99, 0.1], [-0.1, 0.99]]) * 0.995
    units = np.array([1.0, 1e12])
    transition, output = turned * units / units[:, None], np.array([1.0, 0.0])
    decay = Decay(transition, output)
    found = np.vstack([decay.rows(300), decay.rows(700)])
    expected = [output @ np.linalg.matrix_power(transition, row) for row in range(1, 1001)]
    np.testing.assert_allclose(found / units, np.array(expected) / units, rtol=0, atol=1e-11)
    quick = Decay(0.5 * np.eye(2), output)
    np.testing.assert_allclose(quick.rows(60)[:, 0], 0.5 ** np.arange(1, 61), rtol=1e-12)
    assert quick.is_over and not quick.rows(5).any()  # what has died away is none
