# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The fit's own formulas against the chain's discretisation and against finite differences."""

import numpy as np
import pytest

from evaluation.reproduction.periodic_fit import PeriodicProblem
from hyst_control.chain.chain import Chain
from hyst_control.chain.stage import Sampling
from hyst_control.identify.modal.modal_candidate import stages_of
from hyst_control.identify.modal.modal_fit import Problem
from hyst_control.identify.modal.modal_model import ModalModel, Spectra


def random_model(hold: str, delay: tuple[float, float], seed: int = 0) -> ModalModel:
    rng = np.random.default_rng(seed)
    poles = np.array([-0.05 + 0.5j, -0.02 + 1.2j, -0.3])
    c, b = (rng.normal(size=(3, 2)) + 1j * rng.normal(size=(3, 2)) for _ in range(2))
    c[2], b[2] = c[2].real, b[2].real
    return ModalModel(poles, c, b, rng.normal(size=(2, 2)), np.array(delay), hold)


@pytest.mark.parametrize("hold", ["zoh", "foh"])
@pytest.mark.parametrize("delay", [(0.0, 0.0), (0.35, 0.35), (2.0, 2.0), (1.7, 0.2)])
def test_the_response_is_that_of_the_chain(hold, delay):
    model = random_model(hold, delay)
    sample_time = 2e-4
    period = 64
    running = Chain(tuple(stages_of(model, sample_time))).filter(Sampling(sample_time, 2, hold))
    command = np.random.default_rng(1).normal(size=(period, 2))
    running.settle(np.zeros(2))
    output = running.process(np.tile(command, (20, 1)))
    if hold == "zoh":
        output = np.roll(output, 1, axis=0)
    steady = np.fft.fft(output[-period:], axis=0)
    lines = np.arange(1, period // 2)
    expected = np.einsum("koj,kj->ko", model.response(2 * np.pi * lines / period), np.fft.fft(command, axis=0)[lines])
    assert np.allclose(steady[lines], expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_the_gradient_is_the_slope_of_the_cost(hold):
    rng = np.random.default_rng(2)
    angle = np.linspace(0.05, 3.0, 40)

    def spectrum(count: int) -> np.ndarray:
        return rng.normal(size=(40, 2, count)) + 1j * rng.normal(size=(40, 2, count))

    data = [Spectra(angle, spectrum(3), spectrum(3)), Spectra(angle, spectrum(2), spectrum(2), periodic=False)]
    problem = Problem(data, random_model(hold, (0.3, 1.4)), direct=True, free_delay=True)
    problem.apply(0.02 * rng.normal(size=problem.layout.size) * problem.free * (np.arange(problem.layout.size) > 0))
    _, vector, cost = problem.normal_equations()
    assert problem.cost() == pytest.approx(cost, rel=1e-12)
    start = problem.model, problem.transients
    slopes = []
    for direction in rng.normal(size=(12, problem.layout.size)) * problem.free:
        values = []
        for sign in (1, -1):
            problem.model, problem.transients = start
            problem.apply(sign * 1e-6 * direction)
            values.append(problem.cost())
        slopes.append((values[0] - values[1]) / 2e-6 / np.linalg.norm(2 * vector) / np.linalg.norm(direction))
        expected = -2 * vector @ direction / np.linalg.norm(2 * vector) / np.linalg.norm(direction)
        assert slopes[-1] == pytest.approx(expected, abs=1e-5)


def test_compressed_records_have_the_same_cost_for_every_model():
    rng = np.random.default_rng(4)
    angle = np.linspace(0.4, 0.8, 30)
    data = Spectra(angle, rng.normal(size=(30, 2, 5)) + 1j * rng.normal(size=(30, 2, 5)), rng.normal(size=(30, 2, 5)) + 0j)
    for seed in range(3):
        model = random_model("zoh", (0.0, 0.5), seed)
        plain = data.measurement - np.einsum("koj,kjr->kor", model.response(angle), data.command)
        assert Problem([data], model).cost() == pytest.approx(np.sum(np.abs(plain) ** 2), rel=1e-10)


@pytest.mark.parametrize("hold", ["zoh", "foh"])
@pytest.mark.parametrize("late", [0.0, 0.35])
def test_commands_equally_late_give_the_same_equations_line_by_line(hold, late):
    """Against the columns of W themselves, which the general case forms; more inputs than records."""
    rng = np.random.default_rng(3)
    angle = np.linspace(0.05, 3.0, 40)

    def spectrum(rows: int, count: int) -> np.ndarray:
        return rng.normal(size=(40, rows, count)) + 1j * rng.normal(size=(40, rows, count))

    data = [Spectra(angle, spectrum(2, 1), spectrum(2, 1), True), Spectra(angle, spectrum(2, 2), spectrum(2, 2), True)]
    model = random_model(hold, (late, late))
    quick, general = PeriodicProblem(data, model), Problem(data, model)
    for one, other in zip(quick.normal_equations(), general.normal_equations(), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-10, atol=1e-10 * np.max(np.abs(other)))
    assert quick.cost() == pytest.approx(general.cost(), rel=1e-12)
