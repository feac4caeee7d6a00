"""Steps of a rounded command, read from what a record has beyond the model, against the step that rounded it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from hyst_control.diagnose.spectral_lines import command_lattice

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


def test_the_double_is_tried_too():
    """Rounded to 4, of which the spectrum shows the second harmonic alone: the line at 2 would be taken for the step."""
    command, left = record(4.0, np.floor)
    _, half = record(2.0, np.floor)
    found = command_lattice(command, half, RESPONSE)
    assert found[0] == pytest.approx(2.0, rel=0.02)
    assert any(step == pytest.approx(4.0, rel=0.02) for step in found)
    assert command_lattice(command, left, RESPONSE)[0] == pytest.approx(4.0, rel=0.05)


@pytest.mark.parametrize("seed", range(8))
def test_no_step_is_found_where_nothing_was_rounded(seed):
    assert command_lattice(*record(0.0, np.round, seed, disturbance=1.0), RESPONSE) == []


def test_a_plant_that_does_not_answer_has_no_lattice():
    assert command_lattice(*record(1.0, np.round), np.zeros(10)) == []
