# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Steps of a rounded command, read from what a record has beyond the model, against the step that rounded it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from hyst_control.diagnose.record_checks.spectral_lines import command_lattice

RESPONSE = 0.3 * 0.7 ** np.arange(60)  # of a first-order lag
COUNT = 6000


def record(step: float, rounded, seed: int = 4, disturbance: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A command, and what rounding it leaves of the lag's output with noise, from the sample after it."""
    random = np.random.default_rng(seed)
    command = np.clip(25.0 + 9.0 * lfilter([0.02], [1.0, -0.98], random.standard_normal(COUNT)) * 10.0, 0.0, 50.0)
    error = step * rounded(command / step) - command if step else np.zeros(COUNT)
    left = np.append(0.0, lfilter(RESPONSE, 1.0, error)[:-1])
    slow = disturbance * np.cumsum(random.standard_normal(COUNT)) / np.sqrt(COUNT)
    return command, left + slow + 0.05 * random.standard_normal(COUNT)


@pytest.mark.parametrize("rounded", [np.round, np.floor, np.ceil, lambda x: np.floor(x) + 0.5])
@pytest.mark.parametrize("step", [0.5, 1.37, 4.0])
def test_the_step_is_found_however_it_was_rounded_to(step, rounded):
    found = command_lattice(*record(step, rounded, disturbance=1.0), RESPONSE)
    assert found and found[0] == pytest.approx(step, rel=0.5 * step / 50.0)


@pytest.mark.parametrize(("loops", "step"), [(3, 3.27), (6, 4.0)])
def test_the_step_of_a_coarse_lattice_is_suggested_where_a_harmonic_stands_out_more(loops, step):
    """Shrinking triangles, rounded down: the line at half the step is the largest in the spectrum."""
    turns = np.linspace(0.0, loops, COUNT)
    command = 50.0 * (1.0 - 0.8 * np.floor(turns) / loops) * (1.0 - np.abs(1.0 - 2.0 * (turns % 1.0)))
    error = step * np.floor(command / step) - command
    noise = 0.05 * np.random.default_rng(4).standard_normal(COUNT)
    found = command_lattice(command, np.append(0.0, lfilter(RESPONSE, 1.0, error)[:-1]) + noise, RESPONSE)
    assert found[0] == pytest.approx(0.5 * step, rel=0.02)
    assert min(abs(one - step) for one in found) < 0.01 * step


@pytest.mark.parametrize("seed", range(8))
def test_no_step_is_found_where_nothing_was_rounded(seed):
    assert command_lattice(*record(0.0, np.round, seed, disturbance=1.0), RESPONSE) == []


def test_a_plant_that_does_not_answer_has_no_lattice():
    assert command_lattice(*record(1.0, np.round), np.zeros(10)) == []
