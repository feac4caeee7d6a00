# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A softening oscillator, integrated finely, at three levels: one model for all of them, tested on unseen excitation."""

import numpy as np
import pytest

from evaluation.reproduction.periodic_fit import refined
from evaluation.reproduction.softening_modes import Law, Level, fit_softening, schedule, spectra
from hyst_control.chain.chain import Chain
from hyst_control.chain.stage import Sampling
from hyst_control.identify.modal.modal_fit import subspace

PERIOD, SAMPLE_TIME, SUBSTEPS = 1024, 1e-3, 4
FREQUENCY, DAMPING, SOFTENING = 120.0, 0.03, 0.05


def steady_oscillator(command: np.ndarray) -> np.ndarray:
    """x'' + 2 ζ ω x' + ω² x (1 - κ sqrt|x|) = ω² u for held commands (N, R), by Runge-Kutta; the third period."""
    w = 2 * np.pi * FREQUENCY
    step = SAMPLE_TIME / SUBSTEPS
    state = np.zeros((2, command.shape[1]))

    def slope(state: np.ndarray, u: np.ndarray) -> np.ndarray:
        x, v = state
        return np.stack([v, w * w * (u - x * (1 - SOFTENING * np.sqrt(np.abs(x)))) - 2 * DAMPING * w * v])

    output = np.empty((3 * PERIOD, command.shape[1]))
    for k in range(3 * PERIOD):
        output[k] = state[0]
        u = command[k % PERIOD]
        for _ in range(SUBSTEPS):
            a = slope(state, u)
            b = slope(state + 0.5 * step * a, u)
            c = slope(state + 0.5 * step * b, u)
            d = slope(state + step * c, u)
            state = state + step / 6 * (a + 2 * b + 2 * c + d)
    return output[2 * PERIOD :]


@pytest.fixture(scope="module")
def levels() -> list[Level]:
    rng = np.random.default_rng(0)
    made = []
    for amplitude in (0.5, 1.0, 1.5):
        spectrum = np.zeros((PERIOD // 2 + 1, 4), dtype=complex)
        spectrum[1:400] = np.exp(2j * np.pi * rng.random((399, 4)))
        command = np.fft.irfft(spectrum, axis=0)
        command *= amplitude / np.std(command)
        made.append(Level(command[:, None, :], steady_oscillator(command)[:, None, :]))
    return made


def part(level: Level, realisations: list[int]) -> Level:
    return Level(level.command[:, :, realisations], level.measurement[:, :, realisations])


def simulated_error(stage, level: Level, realisation: int) -> float:
    running = Chain((stage,)).filter(Sampling(SAMPLE_TIME, 1, "zoh"))
    command = np.tile(level.command[:, :, realisation], (3, 1))
    running.settle(command[0])
    output = running.process(command)[2 * PERIOD - 1 : -1, 0]
    measured = level.measurement[:, 0, realisation]
    return float(np.std(output - measured) / np.std(measured))


def test_one_softening_model_holds_at_every_level(levels):
    fitted = [part(level, [0, 1, 2]) for level in levels]
    middle = [spectra(fitted[1].command, fitted[1].measurement, 1.0)]
    linear = refined(middle, subspace(middle, [2], np.zeros(1), "zoh")[0], 20).model
    errors = {}
    for law in (None, Law((0.5,))):
        found = fit_softening(fitted, linear, fitted[1].amplitude, SAMPLE_TIME, law, memory=0.05)
        errors[law] = [simulated_error(found.stage, level, 3) for level in levels]
    for level, soft, forced in zip(levels, *errors.values(), strict=True):
        response = linear.response(2 * np.pi * np.arange(1, 400) / PERIOD)[:, 0, 0]
        u, y = (np.fft.rfft(signal[:, 0, 3])[1:400] for signal in (level.command, level.measurement))
        plain = np.linalg.norm(y - response * u) / np.linalg.norm(y)
        assert forced < soft
        if level is not levels[1]:
            assert forced < 0.5 * plain


def test_the_schedule_is_that_of_the_stage():
    assert schedule(1.0, 1.0) == 0.0
    assert schedule(0.5, 1.0) == pytest.approx(-1.0)
