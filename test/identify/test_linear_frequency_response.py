# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Frequency responses against the system's own, and their variances against the scatter of repeated experiments."""

import numpy as np
import pytest
from scipy.signal import lfilter

from evaluation.reproduction.robust_bla import robust_bla
from hyst_control.base.errors import InputError
from hyst_control.identify.modal.frequency_response import local_polynomial

NUM, DEN = np.array([0.0, 0.2, 0.1]), np.array([1.0, -1.2, 0.5])
PERIOD = 256


def true_response(frequency: np.ndarray) -> np.ndarray:
    back = np.exp(-2j * np.pi * frequency)
    return np.polyval(NUM[::-1], back) / np.polyval(DEN[::-1], back)


def multisine(rng: np.random.Generator, period: int = PERIOD, lines: int = 90) -> np.ndarray:
    spectrum = np.zeros(period // 2 + 1, dtype=complex)
    spectrum[1 : lines + 1] = np.exp(2j * np.pi * rng.random(lines))
    signal = np.fft.irfft(spectrum)
    return signal / signal.std()


def experiment(rng: np.random.Generator, noise: float, cubic: float, realisations: int = 6, periods: int = 3):
    command = np.zeros((PERIOD, 1, realisations, periods))
    measurement = np.zeros_like(command)
    for r in range(realisations):
        u = np.tile(multisine(rng), periods + 2)
        y = lfilter(NUM, DEN, u)
        y = y + cubic * y**3 + noise * rng.normal(size=y.shape)
        command[:, 0, r] = u[2 * PERIOD :].reshape(periods, PERIOD).T
        measurement[:, 0, r] = y[2 * PERIOD :].reshape(periods, PERIOD).T
    return command, measurement


def test_noise_and_distortion_are_told_apart_and_sized():
    rng = np.random.default_rng(0)
    linear = robust_bla(*experiment(rng, noise=0.05, cubic=0.0), 1.0)
    error = linear.response[:, 0, 0] - true_response(linear.frequency)
    assert np.mean(np.abs(error) ** 2) == pytest.approx(np.mean(linear.noise_variance), rel=0.5)
    assert np.mean(linear.total_variance) == pytest.approx(np.mean(linear.noise_variance), rel=0.5)
    bent = robust_bla(*experiment(rng, noise=0.002, cubic=0.05), 1.0)
    assert np.mean(bent.total_variance) > 20 * np.mean(bent.noise_variance)
    inside = np.abs(error) < linear.radius(0.95)[:, 0, 0]
    assert 0.8 < inside.mean() <= 1.0


def test_orthogonal_groups_separate_two_inputs():
    rng = np.random.default_rng(1)
    command, measurement = np.zeros((PERIOD, 2, 4, 2)), np.zeros((PERIOD, 2, 4, 2))
    for group in range(2):
        first, second = multisine(rng), multisine(rng)
        for r, sign in enumerate((1.0, -1.0)):
            u = np.stack([first, sign * second], axis=1)
            y = np.stack([lfilter(NUM, DEN, np.tile(u[:, 0], 6)) + 0.3 * np.tile(u[:, 1], 6), 2.0 * np.tile(u[:, 1], 6)], axis=1)
            command[:, :, 2 * group + r] = u[:, :, None]
            measurement[:, :, 2 * group + r] = np.swapaxes(y[4 * PERIOD :].reshape(2, PERIOD, 2), 0, 2).swapaxes(0, 1)
    found = robust_bla(command, measurement, 1.0)
    assert np.allclose(found.response[:, 0, 0], true_response(found.frequency), atol=1e-9)
    assert np.allclose(found.response[:, 0, 1], 0.3, atol=1e-9) and np.allclose(found.response[:, 1], [0.0, 2.0], atol=1e-9)


def test_local_polynomial_takes_the_transient_off():
    rng = np.random.default_rng(2)
    command = rng.normal(size=(2000, 1))
    measurement = lfilter(NUM, DEN, command, axis=0) + 1e-3 * rng.normal(size=command.shape)
    cut = slice(7, None)
    found = local_polynomial([command[cut]], [measurement[cut]], 1.0)
    error = np.abs(found.response[:, 0, 0] - true_response(found.frequency)) ** 2
    assert np.mean(error) < 4 * np.mean(found.noise_variance) < 1e-4
    plain = np.fft.rfft(measurement[cut], axis=0)[1:] / np.fft.rfft(command[cut], axis=0)[1:]
    assert np.mean(np.abs(plain[:, 0] - true_response(found.frequency)) ** 2) > 10 * np.mean(error)


def test_a_step_that_settles_shows_the_response():
    command = np.where(np.arange(600) > 50, 1.0, 0.0)[:, None]
    measurement = lfilter(NUM, DEN, command, axis=0)
    found = local_polynomial([command], [measurement], 0.5, kind="settled", highest=0.5)
    assert found.frequency.max() <= 0.5
    assert np.allclose(found.response[:, 0, 0], true_response(found.frequency * 0.5), atol=2e-3)


def test_inputs_that_are_not_told_apart_are_refused():
    command = np.random.default_rng(3).normal(size=(500, 1)) * np.ones((1, 2))
    with pytest.raises(InputError, match="do not separate the"):
        local_polynomial([command], [command], 1.0)
    with pytest.raises(InputError, match="at least 2 periods"):
        robust_bla(np.zeros((64, 2, 3, 2)), np.zeros((64, 2, 3, 2)), 1.0)
