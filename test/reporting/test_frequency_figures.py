# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Frequency responses of records: those of filters of scipy, with the coherence that noise leaves, and a plot's lines."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import freqz, lfilter

from hyst_control.records.record import Record, Signal
from hyst_control.reporting.frequency_figures import COHERENT, bode, bode_of_record, continuous_phase, measured_responses

RATE = 2000.0
FILTERS = {"x": ([0.0, 0.02, 0.01], [1.0, -1.6, 0.7]), "y": ([0.0, 0.3], [1.0, -0.5])}


def recorded(command, noise=0.0, seed=0, axes=("x", "y")):
    driven = np.column_stack([lfilter(*FILTERS[axis], column) for axis, column in zip(axes, command.T, strict=True)])
    measured = driven + noise * np.random.default_rng(seed).standard_normal(driven.shape)
    time = np.arange(len(command)) / RATE
    return Record({"command": Signal(time, command, axes, "V"), "measurement": Signal(time, measured, axes, "um")}, "r")


def true(axis, frequency):
    return freqz(*FILTERS[axis], worN=2 * np.pi * frequency / RATE)[1]


def test_noise_tells_the_response_of_every_axis():
    command = 50.0 + np.random.default_rng(1).standard_normal((200_000, 2))
    for found, axis in zip(measured_responses(recorded(command)), FILTERS, strict=True):
        assert found.name == f"measured {axis}"
        error = np.abs(found.values / true(axis, found.frequency) - 1.0)
        assert np.median(error) < 0.01 and found.coherence.min() > 0.9


def test_noise_of_the_sensor_lowers_the_coherence_as_it_must():
    command, noise = np.random.default_rng(2).standard_normal((400_000, 1)), 0.3
    [found] = measured_responses(recorded(command, noise, axes=("y",)))
    power = np.abs(true("y", found.frequency)) ** 2
    error = found.coherence - power / (power + noise**2)
    assert np.mean(error) == pytest.approx(0.0, abs=0.03)
    assert np.mean(np.abs(error) < 0.15) > 0.95  # its scatter is sqrt(2 γ²) (1 - γ²) / sqrt(averages), 0.09 at most of some 40


def test_a_command_that_repeats_leaves_no_leakage():
    period, lines = 1000, np.arange(1, 400)
    phases = np.random.default_rng(3).uniform(0, 2 * np.pi, len(lines))
    wave = np.cos(2 * np.pi * np.outer(np.arange(period), lines) / period + phases).sum(axis=1)
    record = recorded(np.tile(wave, 12)[:, None], axes=("y",))
    [found] = measured_responses(record)
    assert len(found.frequency) == len(lines)  # what is not excited is not told
    np.testing.assert_allclose(found.values, true("y", found.frequency), rtol=1e-9)
    np.testing.assert_allclose(found.coherence, 1.0)


def test_of_axes_that_move_together_each_follows_its_own_command():
    command = np.repeat(np.random.default_rng(7).standard_normal((100_000, 1)), 2, axis=1)
    for found, axis in zip(measured_responses(recorded(command)), FILTERS, strict=True):
        assert len(found.frequency) > 100
        assert np.median(np.abs(found.values / true(axis, found.frequency) - 1.0)) < 0.01 and np.median(found.coherence) > 0.99


def test_the_phase_goes_on_where_it_scatters():
    frequency = np.linspace(1.0, 1000.0, 2000)
    late = -2 * np.pi * frequency * 0.01  # ten turns
    scatter = np.random.default_rng(6).uniform(-1.8, 1.8, len(late))
    np.testing.assert_allclose(continuous_phase(np.exp(1j * (late + scatter))), late + scatter, atol=1e-9)
    assert np.abs(np.unwrap(np.angle(np.exp(1j * (late + scatter)))) - late).max() > 6.0  # what else would happen


def test_what_is_noise_is_not_drawn():
    command = np.random.default_rng(4).standard_normal((50_000, 1))
    record = recorded(command, noise=0.3, axes=("y",))
    magnitude, phase, coherence = bode_of_record(record)
    [found] = measured_responses(record)
    assert 0 < len(magnitude.lines[0].x) == np.count_nonzero(found.coherence >= COHERENT) < len(coherence.lines[0].x)
    assert coherence.y_range == (0.0, 1.05)
    assert magnitude.y_title == "magnitude [um/V]" and magnitude.logarithmic == "xy" and phase.logarithmic == "x"


def test_without_a_measured_response_there_is_no_coherence():
    command = np.random.default_rng(5).standard_normal((20_000, 1))
    [found] = measured_responses(recorded(command, axes=("y",)))
    assert len(bode([type(found)("model", found.frequency, found.values)], "um/V")) == 2
