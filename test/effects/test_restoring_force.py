# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Forces on the mechanics against their equations of motion, integrated in small steps."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from hyst_control.chain import Chain, Sampling
from hyst_control.chain.linear.linear_stages import StateSpace, TransferFunction
from hyst_control.chain.stage import Stage
from hyst_control.effects.clearance import Clearance
from hyst_control.effects.cubic_stiffness import CubicStiffness
from hyst_control.effects.dry_friction import DryFriction

MASS, DAMPING, STIFFNESS, STEP = 1e-4, 0.02, 10.0, 5e-4
MECHANICS = TransferFunction([1.0], [MASS, DAMPING, STIFFNESS])


def command() -> np.ndarray:
    time = STEP * np.arange(3000)
    return 20.0 * np.sin(2 * np.pi * 3 * time) + 10.0 * np.sin(2 * np.pi * 11 * time)


def run(stages: tuple[Stage, ...], u: np.ndarray, hold: str = "zoh") -> np.ndarray:
    running = Chain(stages).filter(Sampling(STEP, 1, hold))
    running.settle(u[:1])
    return running.process(u[:, None])[:, 0]


def integrated(u: np.ndarray, force: Callable[[float, float], float]) -> np.ndarray:
    """The same machine by small explicit steps, from rest; u is held."""
    position, speed, parts, found = u[0] / STIFFNESS, 0.0, 50, []
    for value in u:
        for _ in range(parts):
            push = (value - DAMPING * speed - STIFFNESS * position - force(position, speed)) / MASS
            position += STEP / parts * (speed + 0.5 * STEP / parts * push)
            speed += STEP / parts * push
        found.append(position)
    return np.array(found)


@pytest.mark.parametrize(
    "stage, force, most",
    [
        (CubicStiffness(0.3, 2.0), lambda x, v: 3.0 * (x / 2.0) ** 3, 0.01),
        (CubicStiffness(-0.3, 3.0), lambda x, v: -3.0 * (x / 3.0) ** 3, 0.01),
        (Clearance(0.3, 0.2), lambda x, v: -2.0 * min(max(x / 0.3, -1.0), 1.0), 0.06),
        # A steep transition stands for the sign: where it sticks the motion creeps a little.
        (DryFriction(0.2), lambda x, v: 2.0 * np.tanh(v / 0.02), 0.02),
    ],
)
def test_a_force_changes_what_its_equation_says(stage, force, most):
    u = command()
    real = integrated(u, force) - integrated(u, lambda x, v: 0.0)
    simulated = run((MECHANICS, stage), u) - run((MECHANICS,), u)
    assert np.std(simulated - real) < most * np.std(real)


def test_friction_of_a_speed_is_that_of_its_equation():
    """A carriage without a spring, of which the speed is measured; a cart on a slope stays where the slope is too small."""
    u, gain, corner, slack = 2.0 * np.sin(2 * np.pi * 3.0 * STEP * np.arange(3000)), 360.0, 2.0, 108.0
    found = run((TransferFunction([gain], [1.0, corner]), DryFriction(slack, speed=1.0)), u)
    speed, expected = 0.0, []
    for value in u:
        for _ in range(20):
            free = speed + STEP / 20 * (gain * value - corner * speed)
            speed = np.sign(free) * max(abs(free) - STEP / 20 * slack * corner, 0.0)
        expected.append(speed)
    np.testing.assert_allclose(found, expected, atol=0.005 * np.max(expected))
    held = run((TransferFunction([gain], [1.0, corner]), DryFriction(slack, speed=1.0)), np.full(500, 0.5 * slack * corner / gain))
    np.testing.assert_allclose(held, 0.0, atol=1e-12)


def test_friction_of_a_stiff_machine_is_play():
    """Mechanics much faster than the command, seen through the approximation of a delay, which goes to the other side first."""
    late = TransferFunction([-2e-4, 2.0], [1e-4, 1.0])
    stiff = TransferFunction([5e7], [1.0, 8e3, 5e7])
    u = 10.0 * np.sin(2 * np.pi * 1.0 * STEP * np.arange(4000))
    place, play = 0.0, []
    for value in 2.0 * u:
        place = min(max(place, value - 0.7), value + 0.7)
        play.append(place)
    for mechanics in (TransferFunction([2.0 * 5e7], [1.0, 8e3, 5e7]), _series(late, stiff)):
        found = run((mechanics, DryFriction(0.7)), u)
        assert np.std(found[1000:] - np.array(play)[1000:]) < 0.1 * 0.7


def _series(first: TransferFunction, second: TransferFunction) -> TransferFunction:
    return TransferFunction(np.polymul(first.num, second.num).tolist(), np.polymul(first.den, second.den).tolist())


def test_an_acceleration_has_no_gain_at_rest_and_a_force_all_the_same():
    acceleration = TransferFunction([1.0, 0.0, 0.0], [MASS, DAMPING, STIFFNESS])
    u = command()
    moved = run((acceleration, CubicStiffness(10.0, 1e5)), u) - run((acceleration,), u)
    assert 0.0 < np.std(moved) < np.std(run((acceleration,), u))


def test_each_axis_of_coupled_mechanics_has_its_own_force():
    single = MECHANICS.systems(1)[0]
    zeros, empty = np.zeros((2, 2)), np.zeros((1, 2))
    together = StateSpace(
        np.block([[single.A, zeros], [zeros, single.A]]).tolist(),
        np.block([[single.B, zeros[:, :1]], [zeros[:, :1], single.B]]).tolist(),
        np.block([[single.C, empty], [empty, single.C]]).tolist(),
        np.zeros((2, 2)).tolist(),
    )
    u = np.stack([command(), command()[::-1]], axis=1)
    running = Chain((together, CubicStiffness([0.3, 0.0], 2.0))).filter(Sampling(STEP, 2))
    running.settle(u[0])
    found = running.process(u)
    np.testing.assert_allclose(found[:, 0], run((MECHANICS, CubicStiffness(0.3, 2.0)), u[:, 0]), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(found[:, 1], run((MECHANICS,), u[:, 1]), rtol=1e-9, atol=1e-9)
