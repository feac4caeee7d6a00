# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A binary command drives a mode, and the sensor freezes, jumps, or stops at its rails; the findings say where, and what to do."""

import numpy as np
import pytest
from scipy.signal import lfilter

from hyst_control.records.outliers import outlying
from hyst_control.records.tables.units import unit_of
from hyst_control.records.validity.checks import examined
from hyst_control.records.validity.facts import longest_stand
from hyst_control.records.validity.findings import Trial

STEP, ROWS = 1e-4, 20_000
COMMAND = np.repeat(np.random.default_rng(7).choice([-1.0, 1.0], ROWS // 10), 10)
POLE = np.exp((-0.05 + 1j) * 2 * np.pi * 120.0 * STEP)
MODE = lfilter([0.0, abs(1 - POLE) ** 2], [1.0, -2.0 * POLE.real, abs(POLE) ** 2], COMMAND)
SOUND = MODE + 0.005 * np.ptp(MODE) * np.random.default_rng(8).standard_normal(ROWS)


def found(measured, command=COMMAND):
    refusals, notes = examined([Trial("r", command[:, None], measured[:, None], STEP, ("x",))])
    return [each.text() for each in refusals], [each.text() for each in notes]


def test_a_sound_record_of_a_binary_command_has_no_findings():
    assert found(SOUND) == ([], [])


@pytest.mark.parametrize("begin", [0, 4000, ROWS - 300])
def test_a_sensor_that_freezes_while_a_binary_command_goes_on_is_a_note(begin):
    frozen = SOUND.copy()
    frozen[begin : begin + 300] = frozen[begin]
    refusals, [note] = found(frozen)
    assert not refusals and f"for 300 samples from {begin * STEP:.4g} s on" in note and "hyst edit --from" in note


def test_a_sensor_that_stands_with_its_command_or_as_often_as_ever_is_not_frozen():
    resting = COMMAND.copy()
    resting[4000:4300] = 1.0
    still = SOUND.copy()
    still[4000:4300] = still[4000]
    assert longest_stand(resting, still) is None
    coarse = np.round(SOUND / 0.2) * 0.2
    assert longest_stand(COMMAND, coarse) is None
    limited = np.minimum(SOUND, 0.99 * SOUND.max())
    limited[4000:4300] = limited.max()
    assert longest_stand(COMMAND, limited) is None


def test_a_refusal_says_where_a_sensor_died():
    dead = SOUND.copy()
    dead[9000:11500] = dead[9000]
    [refusal], _ = found(dead)
    assert "for 2500 samples from 0.9 s on, in which the command passes 100 % of its range" in refusal


def test_outliers_next_to_jumps_of_the_command_and_to_each_other_are_found():
    random = np.random.default_rng(9)
    rows = np.sort(random.choice(np.arange(10, ROWS - 10, 30), 25, replace=False))
    rows = np.append(rows, rows[:3] + 8)
    spoilt = SOUND.copy()
    spoilt[rows] += random.choice([-1.0, 1.0], len(rows)) * np.ptp(SOUND)
    assert np.flatnonzero(outlying(spoilt[:, None], COMMAND[:, None])).tolist() == sorted(rows)
    # What answers every jump alike is the machine.
    answering = SOUND + np.ptp(SOUND) * np.diff(COMMAND, prepend=COMMAND[0])
    assert not outlying(answering[:, None], COMMAND[:, None]).any()


def test_both_rails_of_a_sensor_are_named():
    _, [note] = found(np.clip(SOUND, -0.6 * SOUND.max(), 0.5 * SOUND.max()))
    assert f"at {0.5 * SOUND.max():.4g} um in" in note and f"and at {-0.6 * SOUND.max():.4g} um in" in note


def test_a_binary_command_in_the_place_of_the_measurement_is_told_from_a_dead_sensor():
    refusals, _ = found(COMMAND, SOUND)
    assert "swap command and measurement" in refusals[0]
    others = np.random.default_rng(10).standard_normal(ROWS)
    assert "check the sensor" in found(COMMAND, others)[0][0]


def test_a_measurement_in_another_unit_is_told_in_words():
    trials = [Trial(name, COMMAND[:, None], size * SOUND[:, None], STEP, ("x",)) for name, size in (("a", 1.0), ("b", 1e-3))]
    [refusal], _ = examined(trials)
    assert "(1000 times as large)" in refusal.text()


@pytest.mark.parametrize("unit", ["degC", "degF", "°C", "°F", "degC/V"])
def test_temperatures_are_units(unit):
    assert unit_of(unit) == (unit, 1.0)
