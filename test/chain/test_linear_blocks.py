# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Long blocks give what the same rows give one by one."""

import numpy as np
import pytest

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
@pytest.mark.parametrize("states, axes", [(1, 1), (2, 1), (FEW, 1), (FEW + 1, 1), (3, 2), (13, 3), (48, 3)])
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


def test_a_system_without_states_has_no_rows_to_sum() -> None:
    quads, acting, ends = quads_of(np.zeros((2, 0, 0)))
    assert quads.shape == (0, 4) and not len(acting) and ends.tolist() == [[0], [0]]
