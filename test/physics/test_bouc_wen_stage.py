# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The Bouc-Wen stage against scipy's integration of its equations, and what makes it a stage with memory."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hyst_plant_sim.physics import bouc_wen_stage as stage


def test_motion_is_the_solution_of_the_equations():
    """Adaptive steps of eighth order; the creep's lags are fed by the motion at the samples, held."""
    command = 50.0 * np.sin(2 * np.pi * 80.0 * stage.SAMPLE_TIME * np.arange(120))
    w = 2 * np.pi * stage.FREQUENCY

    def slopes(_, state, drive):
        y, v, h = state
        turn = stage.STIFFNESS * v - stage.BETA * abs(v) * h - stage.GAMMA * v * abs(h)
        return [v, w**2 * (drive - y - h) - 2 * stage.DAMPING * w * v, turn]

    state, moved = np.zeros(3), []
    for value in command:
        moved.append(state[0])
        state = solve_ivp(slopes, (0.0, stage.SAMPLE_TIME), state, "DOP853", args=(stage.GAIN * value,), rtol=1e-10, atol=1e-12).y[
            :, -1
        ]
    shares = stage.CREEP_TIMES**stage.CREEP_POWER
    shares *= stage.CREEP_SHARE / shares.sum()
    late, expected = np.zeros_like(shares), []
    for value in moved:
        expected.append((1.0 - stage.CREEP_SHARE) * value + shares @ late)
        late += (1.0 - np.exp(-stage.SAMPLE_TIME / stage.CREEP_TIMES)) * (value - late)
    np.testing.assert_allclose(stage.respond(command[:, None], 1, noise=0.0)[:, 0], expected, atol=2e-6 * np.ptp(expected))


def test_the_way_up_differs_from_the_way_down_and_the_noise_from_seed_to_seed():
    step = stage.SAMPLE_TIME
    command = 60.0 * np.sin(2 * np.pi * 5.0 * step * np.arange(round(0.4 / step)))[:, None]
    measured = stage.respond(command, 1, noise=0.0)[-round(0.2 / step) :, 0]
    rising = np.interp(0.0, command[-round(0.2 / step) :][: round(0.05 / step), 0], measured[: round(0.05 / step)])
    quarter, rest = round(0.05 / step), command[-round(0.2 / step) :, 0]
    falling = np.interp(0.0, -rest[quarter : 3 * quarter], measured[quarter : 3 * quarter])
    assert falling - rising > 0.05 * np.ptp(measured)
    noise = stage.respond(command, 1) - stage.respond(command, 1, noise=0.0)
    assert noise.std() == pytest.approx(stage.NOISE, rel=0.1)
    assert not np.array_equal(stage.respond(command, 1), stage.respond(command, 2))
