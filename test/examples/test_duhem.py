"""Duhem hysteresis and creep operators: against their equations and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hyst_control.base.errors import InputError
from hyst_control.chain import Chain, Sampling, Stage
from hyst_control.chain.hysteresis.creep_operators import CreepOperators
from hysteretic_oscillators.stages.duhem import Duhem

STAGE = Duhem(
    slope=[0.1, 0.2], alpha=[-0.03, 0.05], beta=[0.02, 0.04], gamma=[-0.006, 0.01], exponent=[1.3, 1.0], growth=[4e-3, 0.0]
)


def output(stage: Stage, command: np.ndarray, sample_time: float = 1e-3, hold: str = "foh") -> np.ndarray:
    running = Chain((stage,)).filter(Sampling(sample_time, command.shape[1], hold))
    running.settle(np.zeros(command.shape[1]))
    return running.process(command)


def test_it_solves_its_differential_equation():
    """Along the way of the command, straight from one turn to the next: dz/du by scipy."""
    turns = np.array([[0.0, 0.0], [80.0, 40.0], [20.0, -30.0], [60.0, 35.0], [-40.0, -90.0], [90.0, 10.0]])
    found = output(STAGE, turns)
    for axis in range(2):
        alpha, beta, gamma, n, growth = (getattr(STAGE, name)[axis] for name in ("alpha", "beta", "gamma", "exponent", "growth"))
        z = 0.0
        for begin, end, row in zip(turns[:-1, axis], turns[1:, axis], found[1:, axis], strict=True):
            way = end - begin

            def rate(s, z, begin=begin, way=way, alpha=alpha, beta=beta, gamma=gamma, n=n, growth=growth):
                pull = beta * np.sign(way * z) + gamma
                return way * (alpha * (1.0 + growth * (begin + way * s)) - pull * np.abs(z) ** n)

            z = solve_ivp(rate, (0.0, 1.0), [z], rtol=1e-10, atol=1e-12, max_step=1e-3).y[0, -1]
            assert row == pytest.approx(STAGE.slope[axis] * end + z, abs=1e-4)


def test_with_exponent_one_it_is_dahls_exponential():
    """With gamma 0 the memory saturates at alpha / beta as 1 - exp(-beta u)."""
    u = np.linspace(0.0, 100.0, 51)[:, None]
    found = output(Duhem(0.1, -0.04, 0.05), u)[:, 0]
    np.testing.assert_allclose(found, 0.1 * u[:, 0] - 0.8 * (1.0 - np.exp(-0.05 * u[:, 0])), atol=1e-6)


def test_it_does_not_depend_on_the_rate_or_on_the_samples():
    coarse = 50.0 * np.sin(np.linspace(0.0, 12.0, 60))[:, None] * np.ones(2)
    fine = np.stack([np.interp(np.arange(0, 59.001, 0.05), np.arange(60), column) for column in coarse.T], axis=1)
    np.testing.assert_allclose(output(STAGE, fine)[::20], output(STAGE, coarse), atol=1e-4)


def test_wider_loops_keep_the_straight_line():
    u = 50.0 * np.sin(np.linspace(0.0, 12.0, 400))[:, None] * np.ones(2)
    line = u * np.array(STAGE.slope)
    wide = output(STAGE.with_loop_width(np.array([0.2, -0.5])), u)
    np.testing.assert_allclose(wide - line, (output(STAGE, u) - line) * [1.2, 0.5], atol=1e-12)


def test_parts_of_a_step_arrive_late():
    """1 - Σ c exp(-t / τ) after a step at t = 0, at any sampling."""
    creep = CreepOperators([1e-3, 0.2], [0.05, 0.03])
    for sample_time in (1e-4, 2e-2):
        found = output(creep, np.ones((50, 1)), sample_time, "zoh")[:, 0]
        time = sample_time * np.arange(1, 51)
        np.testing.assert_allclose(found, 1.0 - 0.05 * np.exp(-time / 1e-3) - 0.03 * np.exp(-time / 0.2), rtol=1e-12)


def test_what_makes_no_sense_is_refused():
    with pytest.raises(InputError, match="beta: must be"):
        Duhem(0.1, -0.04, -0.05)
    with pytest.raises(InputError, match="shares: 1 shares for 2 times"):
        CreepOperators([1e-3, 0.2], [0.05])
