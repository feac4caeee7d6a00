# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Long blocks give what the same rows give one by one."""

from functools import reduce

import numpy as np
import pytest
from scipy.special import gammainc

from hyst_control.chain import Chain, Sampling
from hyst_control.chain.linear.linear_kernels import FEW, quads_of
from hyst_control.chain.linear.linear_stages import Delay, StateSpace, TransferFunction
from hyst_control.chain.stage import frozen


def coupled(states: int, axes: int) -> StateSpace:
    """A stable system whose matrix is neither full nor diagonal."""
    random = np.random.default_rng(5)
    a = np.diag(-random.uniform(50.0, 2000.0, states))
    a[np.tril_indices(states, -1)] = np.where(random.uniform(size=states * (states - 1) // 2) < 0.3, 40.0, 0.0)
    b, c, d = (random.standard_normal(shape) for shape in ((states, axes), (axes, states), (axes, axes)))
    return StateSpace(frozen(a), frozen(b), frozen(c), frozen(d))


@pytest.mark.parametrize("hold", ["zoh", "foh"])
@pytest.mark.parametrize("states, axes", [(1, 1), (2, 1), (FEW, 1), (FEW + 1, 1), (13, 1), (3, 2), (13, 3), (48, 3)])
def test_a_block_gives_what_its_rows_give(states: int, axes: int, hold: str) -> None:
    chain = Chain((Delay((0.00013,) * axes), coupled(states, axes)))
    command = np.random.default_rng(6).standard_normal((517, axes))
    sampling = Sampling(1e-4, axes, hold)
    together, apart = chain.filter(sampling), chain.filter(sampling)
    together.settle(command[0])
    apart.settle(command[0])
    # Two long blocks with a short one in between: the state and the past inputs are handed on.
    found = np.concatenate([together.process(part) for part in np.split(command, [200, 230])])
    np.testing.assert_array_equal(found, np.concatenate([apart.process(row[None]) for row in command]))


def test_a_block_of_several_axes_gives_what_its_rows_give() -> None:
    chain = Chain((Delay((0.00013, 0.00035)), TransferFunction(((1.0,), (2.0, 3e3)), ((1e-6, 1e-3, 1.0), (1e-4, 1.0)))))
    command = np.random.default_rng(7).standard_normal((300, 2))
    together, apart = (chain.filter(Sampling(1e-4, 2, "foh")) for _ in range(2))
    together.settle(command[0])
    apart.settle(command[0])
    np.testing.assert_array_equal(together.process(command), np.concatenate([apart.process(row[None]) for row in command]))


def test_many_modes_take_the_step_of_their_sum() -> None:
    random = np.random.default_rng(8)
    size, damping, gain = 2 * np.pi * np.geomspace(20.0, 900.0, 12), random.uniform(0.01, 0.2, 12), random.uniform(-1.0, 1.0, 12)
    modes = [np.array([1.0 / w**2, 2.0 * z / w, 1.0]) for w, z in zip(size, damping, strict=True)]
    others = [reduce(np.convolve, modes[:i] + modes[i + 1 :]) for i in range(len(modes))]
    running = TransferFunction(sum(g * one for g, one in zip(gain, others, strict=True)), reduce(np.convolve, modes)).filter(
        Sampling(1e-4, 1, "zoh")
    )
    assert len(running.groups) == 12 * 2 // FEW  # none of them acts on another
    running.settle(np.zeros(1))
    time = 1e-4 * np.arange(1, 4001)[:, None]
    decay, swing = damping * size, size * np.sqrt(1.0 - damping**2)
    step = gain * (1.0 - np.exp(-decay * time) * (np.cos(swing * time) + decay / swing * np.sin(swing * time)))
    np.testing.assert_allclose(running.process(np.ones((4000, 1)))[:, 0], step.sum(axis=1), atol=1e-7)


def test_poles_that_coincide_are_run_together() -> None:
    lags, corner = 9, 2 * np.pi * 150.0
    running = TransferFunction((1.0,), reduce(np.convolve, [np.array([1.0 / corner, 1.0])] * lags)).filter(Sampling(1e-4, 1, "zoh"))
    assert not running.groups
    running.settle(np.zeros(1))
    time = 1e-4 * np.arange(1, 401)
    np.testing.assert_allclose(running.process(np.ones((400, 1)))[:, 0], gammainc(lags, corner * time), atol=1e-9)


def test_a_system_without_states_has_no_rows_to_sum() -> None:
    quads, acting, ends = quads_of(np.zeros((2, 0, 0)))
    assert quads.shape == (0, 4) and not len(acting) and ends.tolist() == [[0], [0]]
