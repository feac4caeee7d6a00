# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Lines of a residual that are a vibration, and those that are not."""

from __future__ import annotations

import numpy as np
import pytest

from hyst_control.chain import Chain
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.diagnose.problem.problem import Piece, Problem
from hyst_control.diagnose.record_checks.spectral_lines import background, lines
from hyst_control.model_file import Model

STEP = 5e-3
TIME = STEP * np.arange(6000)


@pytest.mark.parametrize("frequency, due", [(3.0, []), (3.5, [3.5])])
def test_a_harmonic_of_a_sine_that_swells_is_no_vibration(frequency, due):
    """Unipolar strokes of changing height, whose mean wanders with them; a line at their third harmonic, and one between two."""
    height = 1.0 + 0.8 * np.sin(2 * np.pi * 0.1 * TIME)
    command = (0.5 * height * (1.0 - np.cos(2 * np.pi * TIME)))[:, None]
    model = Model("gain", ("x",), {"command": "V", "measurement": "um"}, STEP, Chain((TransferFunction((1.0,), (1.0,)),)))
    problem = Problem(model, (Piece(command, command),), STEP, "zoh", np.array([1e-3]))
    residual = 1e-3 * np.random.default_rng(2).standard_normal(len(TIME)) + 0.02 * height * np.sin(2 * np.pi * frequency * TIME)
    found = lines(problem, residual / 1e-3)["vibration"]
    assert found == pytest.approx(due, abs=0.05)


@pytest.mark.parametrize("frequency, due", [(1.98, []), (7.4, [7.4])])
def test_a_harmonic_of_six_strokes_is_no_vibration(frequency, due):
    """A fundamental between two bins of so short a record, and a line at its second harmonic or at none."""
    time = TIME[TIME < 6.0]
    command = (1.0 - np.cos(2 * np.pi * 0.99 * time))[:, None]
    model = Model("gain", ("x",), {"command": "V", "measurement": "um"}, STEP, Chain((TransferFunction((1.0,), (1.0,)),)))
    problem = Problem(model, (Piece(command, command),), STEP, "zoh", np.array([1e-3]))
    residual = 1e-3 * np.random.default_rng(2).standard_normal(len(time)) + 0.02 * np.sin(2 * np.pi * frequency * time)
    assert lines(problem, residual / 1e-3)["vibration"] == pytest.approx(due, abs=0.05)


def test_a_line_keeps_its_frequency_where_rows_in_between_do_not_count():
    """Half a period is missing twice: moved together, the rows would hold no sine of 22.3 Hz."""
    keep = np.ones(len(TIME), dtype=bool)
    keep[2000:2004] = keep[4100:4105] = False
    random = np.random.default_rng(2)
    command = random.standard_normal((len(TIME), 1))
    model = Model("gain", ("x",), {"command": "V", "measurement": "um"}, STEP, Chain((TransferFunction((1.0,), (1.0,)),)))
    problem = Problem(model, (Piece(command, command, keep),), STEP, "zoh", np.array([1e-3]))
    residual = 1e-3 * random.standard_normal(len(TIME)) + 0.02 * np.sin(2 * np.pi * 22.3 * TIME)
    assert lines(problem, residual[keep] / 1e-3)["vibration"] == pytest.approx([22.3], abs=2e-3)


@pytest.mark.parametrize("length, reach", [(1, 3), (5, 9), (40, 9), (300, 40)])
def test_the_background_is_the_median_around_every_bin(length: int, reach: int) -> None:
    """A few lines on a sloping floor: the median of every window, of what is mirrored at the ends, one after the other."""
    power = np.random.default_rng(length).exponential(size=length) * np.linspace(5.0, 1.0, length)
    power[::17] *= 1e4
    order = np.arange(-reach, length + reach)
    if length > reach + 1:
        order = np.abs(order)
        order = np.where(order < length, order, 2 * (length - 1) - order)
    windows = [power[np.clip(order[i : i + 2 * reach + 1], 0, length - 1)] for i in range(length)]
    np.testing.assert_array_equal(background(power, reach), [np.sort(window)[reach] / np.log(2.0) for window in windows])


def test_a_line_of_another_axis_command_is_no_vibration():
    """Axes couple: what the other one is driven at is seen on this one too."""
    random = np.random.default_rng(5)
    command = random.standard_normal((len(TIME), 1))
    beside = 5.0 * np.sin(2 * np.pi * 22.5 * TIME)[:, None]
    model = Model("gain", ("x",), {"command": "V", "measurement": "um"}, STEP, Chain((TransferFunction((1.0,), (1.0,)),)))
    residual = random.standard_normal(len(TIME)) + np.sin(2 * np.pi * 22.5 * TIME)
    for driven_beside, due in ((None, [22.5]), (beside, [])):
        piece = Piece(command, command, others=beside, driven_beside=driven_beside)
        found = lines(Problem(model, (piece,), STEP, "zoh", np.array([1e-3])), residual)["vibration"]
        assert found == pytest.approx(due, abs=0.05)
