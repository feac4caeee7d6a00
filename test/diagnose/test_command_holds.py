# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Holds of the command, of any length and from any sample on, found in what a model leaves: the truth is made row by row."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyst_control.chain import Chain
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.diagnose.problem.coefficient_prior import scatter_of
from hyst_control.diagnose.problem.problem import Piece, Problem
from hyst_control.diagnose.search.command_holds import command_holds, impulse_response
from hyst_control.diagnose.search.fit import Linearized
from hyst_control.model_file import Model

STEP, ROWS, POLE, NOISE = 1e-3, 4000, 0.9, 0.01


def lagged(command):
    """y_k = 0.9 y_(k-1) + 0.1 u_(k-1), from rest at the first command."""
    moved = np.empty_like(command)
    moved[0] = command[0]
    for row in range(1, len(command)):
        moved[row] = POLE * moved[row - 1] + (1.0 - POLE) * command[row - 1]
    return moved


def held(command, samples, first):
    """The newest of the commands first, first + samples, …, and before them the first one."""
    return np.array([command[row - (row - first) % samples] if row >= first else command[0] for row in range(len(command))])


def linearized_of(command, measured):
    rate = -np.log(POLE) / STEP  # of the lag whose samples those are
    lag = Chain((TransferFunction((rate,), (1.0, rate)),))
    model = Model("lag", ("x",), {"command": "V", "measurement": "um"}, STEP, lag, "zoh")
    problem = Problem(model, (Piece(command[:, None], measured[:, None]),), STEP, "zoh", np.array([NOISE]))
    return Linearized(problem, scatter_of(model))


def smooth(seed, fastest=20.0):
    random, time = np.random.default_rng(seed), np.arange(ROWS) * STEP
    return 50.0 + sum(
        random.uniform(2.0, 8.0) * np.sin(2 * np.pi * frequency * time + random.uniform(0.0, 6.0))
        for frequency in random.uniform(0.3, 1.0, 5) * min(fastest, 40.0)
    )


@settings(max_examples=25, deadline=None)
@given(samples=st.integers(2, 64), share=st.floats(0.0, 0.999), seed=st.integers(0, 100))
def test_a_hold_of_any_length_from_any_sample_on_is_found(samples, share, seed):
    """Longer ones only where their ripple leads, or the record does not begin with a long rest at its first command."""
    command, first = smooth(seed, 0.4 / (samples * STEP)), int(share * samples)  # sampled at least twice in its fastest period
    assert (samples, first) in command_holds(linearized_of(command, lagged(held(command, samples, first))))


@pytest.mark.parametrize("seed", range(5))
def test_the_ripple_shows_a_hold_beside_a_larger_gap(seed):
    command = smooth(seed)
    measured = lagged(held(command, 13, 4))
    slow = np.sin(2 * np.pi * 0.6 * np.arange(ROWS) * STEP)
    other = 3.0 * np.std(measured - lagged(command)) * np.sqrt(2.0) * slow
    assert (13, 4) in command_holds(linearized_of(command, measured + other))


def test_the_response_to_an_impulse_is_that_of_the_lag():
    expected = (1.0 - POLE) * POLE ** np.arange(200)
    response = impulse_response(linearized_of(smooth(0), lagged(smooth(0))).problem, 0)
    np.testing.assert_allclose(response[:201], np.append(0.0, expected), atol=1e-9)


def test_a_model_that_does_not_answer_has_no_holds():
    flat = linearized_of(np.full(ROWS, 3.0), np.full(ROWS, 3.0))
    assert impulse_response(flat.problem, 0) is None and command_holds(flat) == []
