# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Diagnoses with a Python function: how records begin, smooth commands, value grids, and what notes say of it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

import hyst_control as hc
from hyst_control.base.errors import InputError
from hyst_control.diagnose.simulator import simulator_model, simulator_notes

RATE, FINE = 500.0, 20
PARAMETERS = {"frequency": (25.0, 0.5, "Hz"), "limit": (12.0, 0.3, "V")}
TRUTH = {"frequency": 25.2, "limit": 12.2}


def spring(command, sample_time, frequency, limit):
    """A motor of gradually limited force on a mass and a spring, in um, exact for a held command, from rest at 0."""
    rate = 2.0 * np.pi * frequency
    num, den, _ = cont2discrete(([rate**2], [1.0, 0.6 * rate, rate**2]), sample_time)
    return lfilter(num[0], den, limit * np.tanh(np.asarray(command) / limit))


def staircase(seed, rows=1000, size=8.0):
    random = np.random.default_rng(seed)
    return np.repeat(random.uniform(-size, size, 80), random.integers(15, 40, 80))[:rows]


def noise(rows, size=0.01):
    return size * np.random.default_rng(7).standard_normal(rows)


def slewed(command, rate, step):
    """A command whose slope is limited, from 0."""
    at, rows = 0.0, []
    for value in command:
        at += np.clip(value - at, -rate * step, rate * step)
        rows.append(at)
    return np.array(rows)


def lagged(command, tau, step):
    at, rows = 0.0, []
    for value in command:
        rows.append(at)
        at += step / tau * (value - at)
    return np.array(rows)


def diagnosed(command, measurement, hold=None, simulate=spring, parameters=PARAMETERS, rate=RATE):
    return hc.diagnose(hc.from_arrays(command, measurement, rate, hold=hold), simulate, parameters=parameters, verbose=False)


@pytest.mark.parametrize(
    ("effect", "parameter", "before", "size"),
    [
        ("amplifier_lowpass", "cutoff", lambda rows: lagged(rows, 1 / (2 * np.pi * 12.0), 1e-4), 12.0),
        ("slew_limit", "rate", lambda rows: slewed(rows, 1200.0, 1e-4), 1200.0),
    ],
)
def test_a_record_begins_with_a_step_from_rest(effect, parameter, before, size):
    command = staircase(1)
    command[:20] = 8.0
    measurement = spring(before(np.repeat(command, 20)), 1e-4, **TRUTH)[::20]
    gap = diagnosed(command, measurement + noise(len(command)))
    [found] = gap.document["effects"]
    assert (gap.verdict, found["name"]) == ("effect", effect)
    assert found["parameters"][parameter]["value"] == pytest.approx(size, rel=0.03)


@pytest.mark.parametrize("hold", [None, "foh"])
def test_a_smooth_command_is_no_gap(hold):
    def command(time):
        return 5.0 * np.sin(2 * np.pi * 1.0 * time) + 3.0 * np.sin(2 * np.pi * 4.0 * time)

    fine, ticks = np.arange(30000) * 1e-4, np.arange(1500) / RATE
    gap = diagnosed(command(ticks), spring(command(fine), 1e-4, **TRUTH)[::20] + noise(1500), hold)
    assert gap.verdict == "no_gap"
    assert any("taken as smooth" in note for note in gap.document["notes"]) == (hold is None)


def test_a_held_command_that_moves_at_every_tick_stays_held():
    command = 5.0 * np.sin(2 * np.pi * 1.0 * np.arange(1500) / RATE) + 3.0 * np.sin(2 * np.pi * 4.0 * np.arange(1500) / RATE)
    gap = diagnosed(command, spring(command, 1 / RATE, **TRUTH) + noise(1500))
    assert gap.verdict == "no_gap" and not gap.document["notes"]


def rounded(command, sample_time, frequency, limit):
    return 0.5 * np.round(spring(command, sample_time, frequency, limit) / 0.5)


@pytest.mark.parametrize(("simulate", "names"), [(spring, ["quantization"]), (rounded, [])])
def test_a_coarse_grid_is_named_unless_the_simulator_has_it(simulate, names):
    command = staircase(2)
    nominal = {name: value[0] for name, value in PARAMETERS.items()}
    measurement = 0.5 * np.round((spring(command, 1 / RATE, **nominal) + noise(len(command), 0.02)) / 0.5)
    gap = diagnosed(
        command, measurement, simulate=simulate, parameters={name: (*value[:1], 1e-6) for name, value in PARAMETERS.items()}
    )
    assert [effect["name"] for effect in gap.document["effects"]] == names


@pytest.mark.parametrize("ppm", [4000.0, -500.0])
def test_two_clocks_are_named_with_their_difference(ppm):
    """The machine runs in twenty times as many steps, and its recorder reads it at its own rate."""
    command = staircase(2, 2000)
    exact = spring(np.repeat(command, FINE), 1 / RATE / FINE, **TRUTH)
    rows = np.arange(len(command)) * (1.0 + 1e-6 * ppm)
    rows = rows[rows < len(command) - 1]
    measurement = np.interp(rows * FINE, np.arange(len(exact)), exact) + noise(len(rows))
    gap = diagnosed(command[: len(rows)], measurement)
    assert gap.document["reasons"] == ["invalid_record", "clock_difference"] and not gap.document["effects"]
    assert gap.document["invalid_records"][0]["value"] == pytest.approx(ppm, abs=15.0)


def test_a_function_that_rounds_beside_a_machine_that_does_not_is_refused():
    command = staircase(2)
    with pytest.raises(InputError, match="rounded: returns multiples of 0.5 um, between which the record has values"):
        notes_of(rounded, command, spring(command, 1 / RATE, **TRUTH) + noise(len(command)))


def test_a_gain_on_a_coarse_command_does_not_round():
    def gain(command, sample_time, frequency, limit):
        return 0.1 * np.append(command[0], command[:-1])

    command = np.round(staircase(2))
    assert notes_of(gain, command, gain(command, 1 / RATE, **TRUTH) + noise(len(command))) == []


def notes_of(simulate, command, measurement):
    record = hc.from_arrays(command, measurement, RATE)
    return simulator_notes(simulator_model(simulate, PARAMETERS, [record]), [record])


@pytest.mark.parametrize(("factor", "units"), [(np.pi / 180 * 1e3, "mrad beside deg"), (1e-3, "mm or rad beside um or mrad")])
def test_a_function_of_another_unit_is_refused(factor, units):
    command = staircase(3)
    measurement = factor * (spring(command, 1 / RATE, **TRUTH) + noise(len(command)))
    with pytest.raises(InputError, match=f"times the simulation, as {units} would be: return the unit of the record"):
        notes_of(spring, command, measurement)


def test_a_gain_that_is_no_factor_between_units_is_none():
    command = staircase(3)
    assert not notes_of(spring, command, 1.2 * (spring(command, 1 / RATE, **TRUTH) + noise(len(command))))


def test_a_function_that_counts_calls_is_told_to_have_a_step_of_its_own():
    def late(command, sample_time, frequency, limit):
        return np.concatenate([np.zeros(3), spring(command, sample_time, frequency, limit)[:-3]])

    command = staircase(4)
    [found] = notes_of(late, command, late(command, 1 / RATE, **TRUTH))
    assert "called with a quarter of the sample time its samples differ by" in found and "give it a step of its own" in found
