# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Oscillators with a hysteretic force: against another integration of the equations, closed forms, and each other."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hyst_control.base.errors import InputError
from hyst_control.chain.chain import Chain
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.chain.memoryless import Gain
from hyst_control.chain.stage import Sampling, Stage
from hyst_control.control.feedback.loop import run_loop
from hyst_control.control.linearization import hysteresis_slopes
from hyst_control.control.tuning import tune
from hyst_control.model_file import Model, Simulator
from hysteretic_oscillators.stages.bouc_wen import BoucWen
from hysteretic_oscillators.stages.duhem import Duhem
from hysteretic_oscillators.stages.duhem_oscillator import DuhemOscillator

SAMPLE_TIME = 1e-4
MASS, DAMPING, STIFFNESS = 1e-6, 8e-4, 6.0
COMMAND = 20.0 * np.random.default_rng(0).normal(size=120)


def run(stage: Stage, command: np.ndarray, hold: str = "zoh", sample_time: float = SAMPLE_TIME) -> np.ndarray:
    """Output from rest at 0 V."""
    running = Chain((stage,)).filter(Sampling(sample_time, 1, hold))
    running.settle(np.zeros(1))
    return running.process(command[:, None])[:, 0]


@pytest.mark.parametrize("hold", ["zoh", "foh"])
@pytest.mark.parametrize("exponent", [1.0, 1.8])
def test_the_equations_are_those_of_the_benchmark(hold, exponent):
    """In its own form, with beta multiplying gamma and delta, by an adaptive integrator of scipy from sample to sample."""
    alpha, beta, gamma, delta = 4.0, 0.6, 0.8, -0.3
    state, expected, before = np.zeros(3), [], 0.0
    for now in COMMAND:
        u = (lambda t, a=before, b=now: a + (b - a) * t / SAMPLE_TIME) if hold == "foh" else (lambda t, b=now: b)

        def rate(t, x, u=u):
            y, v, z = x
            slip = gamma * abs(v) * abs(z) ** (exponent - 1) * z + delta * v * abs(z) ** exponent
            return [v, (u(t) - DAMPING * v - STIFFNESS * y - z) / MASS, alpha * v - beta * slip]

        state = solve_ivp(rate, (0.0, SAMPLE_TIME), state, rtol=1e-9, atol=1e-12, max_step=SAMPLE_TIME / 20).y[:, -1]
        expected.append(state[0])
        before = now
    output = run(BoucWen(MASS, DAMPING, STIFFNESS, alpha, beta * gamma, beta * delta, exponent), COMMAND, hold)
    np.testing.assert_allclose(output, expected, atol=5e-5 * np.ptp(expected))


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_without_slip_it_is_a_linear_oscillator(hold):
    stage = BoucWen(MASS, DAMPING, STIFFNESS, 4.0, 0.0)
    linear = run(TransferFunction([1.0], [MASS, DAMPING, STIFFNESS + 4.0]), COMMAND, hold)
    np.testing.assert_allclose(run(stage, COMMAND, hold), linear, atol=1e-5 * np.ptp(linear))
    (description,) = stage.linearized(1)
    np.testing.assert_allclose(run(description, COMMAND, hold), linear, atol=1e-12)


def test_a_table_of_three_knots_is_a_bouc_wen_law():
    """dz/dy = 4 - (±0.3 sign z - 0.1) |z| has its only bend at 0, and the table goes on straight beyond its ends."""
    knots = np.array([-1.0, 0.0, 2.0])
    rising, falling = (4.0 - (0.3 * way * np.sign(knots) - 0.1) * np.abs(knots) for way in (1.0, -1.0))
    formula = run(BoucWen(MASS, DAMPING, STIFFNESS, 4.0, 0.3, -0.1), COMMAND)
    np.testing.assert_allclose(
        run(DuhemOscillator(MASS, DAMPING, STIFFNESS, knots, rising, falling), COMMAND), formula, rtol=1e-9, atol=1e-9
    )


def test_the_virgin_curve_is_the_closed_form():
    """z(y) = alpha / s (1 - exp(-s y)) with s = beta + gamma, for a command that rises slowly."""
    stage, s = BoucWen(MASS, DAMPING, STIFFNESS, 4.0, 0.5, 0.1), 0.6
    command = np.linspace(0.0, 60.0, 50)[:, None]
    y = stage.at_rest(command)[:, 0]
    np.testing.assert_allclose(STIFFNESS * y + 4.0 / s * (1.0 - np.exp(-s * y)), command[:, 0], rtol=1e-8, atol=1e-8)
    settled = stage.filter(Sampling(SAMPLE_TIME, 1)).settle(np.array([60.0]))
    np.testing.assert_allclose(settled, y[-1:], rtol=1e-8)


def test_a_closed_slow_loop_takes_work():
    command = 30.0 * np.sin(2 * np.pi * np.arange(2000) / 1000.0)
    y = BoucWen(MASS, DAMPING, STIFFNESS, 4.0, 0.5).at_rest(command[:, None])[:, 0]
    work = np.sum(0.5 * (command[1000:-1] + command[1001:]) * np.diff(y[1000:]))
    assert work > 0.02 * np.ptp(command) * np.ptp(y)
    assert y[0] == 0.0 and abs(y[1000]) > 0.01 * np.ptp(y)


def test_the_step_of_integration_is_small_enough():
    """At a coarse sample time against the same command at a sixteenth of it."""
    stage = BoucWen(MASS, DAMPING, STIFFNESS, 4.0, 0.5, -0.2, 1.5)
    fine = run(stage, np.repeat(COMMAND, 16), "zoh", SAMPLE_TIME / 16)[15::16]
    np.testing.assert_allclose(run(stage, COMMAND), fine, atol=5e-5 * np.ptp(fine))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: BoucWen(0.0, 1.0, 1.0, 1.0, 1.0), "mass: must be a number > 0"),
        (lambda: BoucWen(1.0, 1.0, 1.0, 1.0, 1.0, exponent=0.5), "exponent: must be a number from 1 to 50"),
        (lambda: BoucWen(1e-30, 1.0, 1.0, 1.0, 1.0).filter(Sampling(1e-4, 1)), "mass: the fastest time constant"),
        (lambda: DuhemOscillator(1.0, 1.0, 1.0, [0.0, 0.0], [1.0, 1.0], [1.0, 1.0]), "knots: must be at least two and increasing"),
        (lambda: DuhemOscillator(1.0, 1.0, 1.0, [0.0, 1.0], [1.0, 1.0, 1.0], [1.0, 1.0]), "rising: 3 slopes for 2 knots"),
    ],
)
def test_what_makes_no_sense_is_refused_in_one_line(make, words):
    with pytest.raises(InputError, match=words) as caught:
        make()
    assert "\n" not in str(caught.value)


def test_margins_hold_on_a_hysteresis_that_no_compensator_knows():
    """It has its greatest slope in the tuning: the loop settles at 10 % more gain and less, and at twice the gain (6 dB)."""
    hysteresis, mode = Duhem(0.1, -0.03, 0.03, -0.01), TransferFunction([2.5e7], [1.0, 500.0, 2.5e7])
    units = {"command": "V", "measurement": "um"}
    model = Model("m", ("x",), units, 2e-4, Chain((hysteresis, mode)), valid={"command": [0.0, 80.0]})
    (mean,), (greatest,) = hysteresis_slopes(model)
    rise = np.diff(hysteresis.at_rest(np.linspace(0.0, 80.0, 401)[:, None])[:, 0]) / 0.2
    assert rise.min() < mean < greatest <= 1.01 * rise.max()
    gains = tune(model)
    reference = np.full((1500, 1), 4.0)
    for factor in (0.9, 1.1, 2.0):
        plant = Simulator(model.with_stages((hysteresis, Gain(factor), mode)), 2e-4)
        error = run_loop(reference, None, gains.controller(0.0, 150.0).start(1), plant)["measurement"][-300:] - reference[-300:]
        assert np.abs(error).max() < 0.01
