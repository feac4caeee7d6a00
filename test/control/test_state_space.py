# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A model's linear part as one state space: it does what the streaming filters do, delays, coupling and branches included."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyst_control.chain import Chain, Parallel
from hyst_control.chain.linear.linear_stages import Delay, StateSpace, TransferFunction
from hyst_control.control.state_space import state_space
from hyst_control.model_file import Model, simulate

STEP = 1e-3
COUPLED = StateSpace(
    [[-300.0, 40.0], [-20.0, -500.0]], [[300.0, 10.0], [-25.0, 400.0]], [[1.0, 0.2], [0.1, 1.0]], [[0.1, 0.0], [0.0, 0.0]]
)
MODE = TransferFunction([1.0], [1.0 / 400.0**2, 0.2 / 400.0, 1.0])
HALF = TransferFunction([0.5], [1.0])
CHAINS = {
    "a mode": (1, (MODE,)),
    "a mode late by a part of a tick": (1, (MODE, Delay(1.3 * STEP))),
    "a late mode without its own ticks": (1, (MODE, Delay(3.0 * STEP))),
    "a direct path": (1, (TransferFunction([2.0 / 400.0, 1.0], [1.0 / 400.0, 1.0]),)),
    "branches": (1, (Parallel(((MODE,), (HALF, TransferFunction([1.0], [1e-2, 1.0])))), HALF)),
    "axes of their own delays": (2, (TransferFunction([0.1], [1e-3, 1.0]), Delay([0.4 * STEP, 2.7 * STEP]))),
    "coupled axes": (2, (COUPLED, Delay(0.7 * STEP))),
}


def run(system, commands):
    state, found = np.zeros(len(system.a)), []
    for row in commands:
        found.append(system.c @ state + system.d @ row)
        state = system.a @ state + system.b @ row
    return np.array(found)


@pytest.mark.parametrize("name", CHAINS)
@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_it_does_what_the_filters_do(name, seed):
    axes, stages = CHAINS[name]
    commands = np.random.default_rng(seed).normal(0.0, 20.0, (200, axes))
    commands[0] = 0.0  # a simulation begins at rest
    model = Model("m", ("x", "y")[:axes], {"command": "V", "measurement": "um"}, STEP, Chain(stages))
    system = state_space(stages, axes, STEP)
    assert len(system.b) == len(system.a) and system.c.shape == (axes, len(system.a))
    np.testing.assert_allclose(run(system, commands), simulate(model, commands), atol=1e-8)


def test_a_mode_has_its_two_states_and_no_more():
    system = state_space((MODE,), 1, STEP)
    assert system.a.shape == (2, 2) and not system.d.any()
    poles = np.log(np.linalg.eigvals(system.a)) / STEP
    np.testing.assert_allclose(np.abs(poles), 400.0, rtol=1e-9)
