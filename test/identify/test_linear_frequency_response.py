# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Frequency responses against the system's own, and their variances against the scatter of repeated experiments."""

import numpy as np
import pytest
from scipy.signal import lfilter

from hyst_control.base.errors import InputError
from hyst_control.identify.modal.frequency_response import local_polynomial

NUM, DEN = np.array([0.0, 0.2, 0.1]), np.array([1.0, -1.2, 0.5])


def true_response(frequency: np.ndarray) -> np.ndarray:
    back = np.exp(-2j * np.pi * frequency)
    return np.polyval(NUM[::-1], back) / np.polyval(DEN[::-1], back)


def test_local_polynomial_takes_the_transient_off():
    rng = np.random.default_rng(2)
    command = rng.normal(size=(2000, 1))
    measurement = lfilter(NUM, DEN, command, axis=0) + 1e-3 * rng.normal(size=command.shape)
    cut = slice(7, None)
    found = local_polynomial([command[cut]], [measurement[cut]], 1.0)
    error = np.abs(found.response[:, 0, 0] - true_response(found.frequency)) ** 2
    assert np.mean(error) < 4 * np.mean(found.noise_variance) < 1e-4
    assert 0.9 < np.mean(np.sqrt(error) < found.radius(0.95)[:, 0, 0]) <= 1.0
    plain = np.fft.rfft(measurement[cut], axis=0)[1:] / np.fft.rfft(command[cut], axis=0)[1:]
    assert np.mean(np.abs(plain[:, 0] - true_response(found.frequency)) ** 2) > 10 * np.mean(error)


def test_inputs_that_are_not_told_apart_are_refused():
    command = np.random.default_rng(3).normal(size=(500, 1)) * np.ones((1, 2))
    with pytest.raises(InputError, match="do not separate the"):
        local_polynomial([command], [command], 1.0)
