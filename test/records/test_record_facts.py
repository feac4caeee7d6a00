# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Facts of a record that need no model, shifts in time, and what a given model tells of rate and unit."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import bilinear, butter, cont2discrete, lfilter, sosfilt

from hyst_control import excitation
from hyst_control.records.record import Record, Signal
from hyst_control.records.validity.beside_model import REFUTABLE, refutes
from hyst_control.records.validity.checks import examined
from hyst_control.records.validity.facts import (
    copied_gain,
    held_samples,
    implausible,
    longest_stand,
    outliers,
    rails,
    simultaneous_gaps,
)
from hyst_control.records.validity.findings import Trial

STEP = 1e-3
TIME = STEP * np.arange(6000)
COMMAND = 50.0 + 40.0 * np.sin(2 * np.pi * 0.5 * TIME) + 8.0 * np.sin(2 * np.pi * (2.0 + 1.5 * TIME) * TIME)


def answer(command, step=STEP, lag=4e-3):
    """A gain of 0.1 um/V and a lag, sampled before the command of the row acts."""
    pole = np.exp(-step / lag)
    start = command[:1]
    return 0.1 * (start[0] + lfilter([0.0, 1.0 - pole], [1.0, -pole], command - start[0]))


NOISE = 2e-3 * np.random.default_rng(0).standard_normal(len(TIME))
MEASURED = answer(COMMAND) + NOISE


def trial(command, measured, **other):
    return Trial("made", command[:, None], measured[:, None], STEP, ("x",), **other)


def names(command, measured, **other):
    return [{each.name for each in found} for found in examined([trial(command, measured, **other)])]


def test_a_sound_record_has_no_findings():
    assert names(COMMAND, MEASURED) == [set(), set()]


def test_facts_of_a_record_are_notes():
    assert names(COMMAND, np.minimum(MEASURED, 8.5))[1] >= {"at_range_end"}
    assert names(COMMAND, 0.1 * COMMAND + NOISE) == [set(), {"copied_command"}]
    assert "held_command" in names(np.repeat(COMMAND[::5], 5), MEASURED)[1]
    assert "implausible_range" in names(1e3 * COMMAND, MEASURED)[1]
    assert names(COMMAND[200:], MEASURED[:-200])[1] == {"late_measurement"}


def test_a_copy_of_the_command_shows_no_time():
    """Beside a model with a lag a copy is early, or another rate fits better: neither is so."""

    def simulate(command, step):
        return answer(command[:, 0], step, 8e-3)[:, None]

    beside = {"simulate": simulate, "simulated": simulate(COMMAND[:, None], STEP)}
    assert names(COMMAND, 0.1 * COMMAND + NOISE, **beside) == [set(), {"copied_command"}]


def test_a_measurement_that_is_early_is_told_in_milliseconds():
    [finding] = examined([trial(COMMAND[:-30], MEASURED[30:])])[0]
    # The lag of 4 ms hides a part of it.
    assert finding.name == "early_measurement" and 0.02 < finding.value < 0.032
    assert "ms" in finding.text() and "--shift 0.0" in finding.text()


def test_rows_lost_of_the_measurement_are_a_lead_that_grows():
    random = np.random.default_rng(2)
    command = 50.0 + sosfilt(butter(4, 0.04, output="sos"), 100.0 * random.standard_normal(12000))
    measured = answer(command, lag=1e-3) + 2e-3 * random.standard_normal(len(command))
    lost = np.sort(random.choice(len(command), 24, replace=False))
    assert names(command, measured) == [set(), set()]
    assert names(command[:-24], np.delete(measured, lost)) == [set(), {"lost_rows"}]


@pytest.mark.parametrize("rate", [2e-4, -2e-4])
def test_a_shift_that_grows_evenly_is_a_difference_of_clocks(rate):
    random = np.random.default_rng(3)
    time = STEP * np.arange(60000)
    command = 50.0 + sosfilt(butter(4, 0.04, output="sos"), 100.0 * random.standard_normal(len(time)))
    measured = np.interp((1.0 + rate) * time, time, answer(command, lag=1e-3)) + 2e-3 * random.standard_normal(len(time))
    measured, command = measured[:59900], command[:59900]
    [finding] = examined([trial(command, measured)])[1]
    assert finding.name == "clock_difference" and finding.value == pytest.approx(1e6 * rate, rel=0.05)
    assert f"is the {'slower' if rate > 0 else 'faster'} one" in finding.text()


@pytest.mark.parametrize("frequencies", [(2.0, 7.1, 13.3), (1.0, 1.9, 31.0)])
def test_three_sines_tell_no_direction(frequencies):
    command = 50.0 + sum(10.0 * np.sin(2 * np.pi * each * TIME) for each in frequencies)
    measured = answer(command, lag=0.05) + NOISE
    for sense in (1, -1):
        assert names(command[::sense], measured[::sense])[0] == set()


def test_the_shift_that_is_told_mends_the_record():
    signals = {
        "command": Signal(TIME[:-30], COMMAND[:-30, None], ("x",), "V"),
        "measurement": Signal(TIME[:-30], MEASURED[30:, None], ("x",), "um"),
    }
    [part] = Record(signals, "made").shifted(0.03).aligned()
    np.testing.assert_array_equal(part.command[:, 0], COMMAND[30:-30])
    np.testing.assert_array_equal(part.measurement[:, 0], MEASURED[30:-30])


def test_rate_and_unit_beside_a_model():
    def simulate(command, step):
        return answer(command[:, 0], step, 0.05)[:, None]

    measured = answer(COMMAND, lag=0.05) + NOISE

    def found(command, stated=STEP):
        beside = simulate(command[:, None], stated)
        return {
            each.name
            for each in examined([Trial("made", command[:, None], measured[:, None], stated, ("x",), beside, "um", simulate)])[0]
        }

    assert found(COMMAND) == set()
    assert found(COMMAND, 0.1 * STEP) == found(COMMAND, 2.0 * STEP) == {"wrong_rate"}
    assert found(1e3 * COMMAND) == {"scaled_command"}


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_rate_is_told_by_the_octaves_that_know_of_it(factor):
    """A mode of a hundredth of the motion's power beside an error of the model of 8 % of it, which is slow."""
    random = np.random.default_rng(3)
    command = (
        50.0 + 40.0 * np.sin(2 * np.pi * 0.5 * TIME) + 3.0 * sosfilt(butter(2, 0.2, output="sos"), random.standard_normal(6000))
    )
    slow = 0.1 * 0.08 * (command - 50.0) ** 2 / 40.0

    def simulate(command, step, frequency=30.0):
        pole = 2 * np.pi * frequency
        top, bottom = bilinear([pole**2], [1.0, 0.2 * pole, pole**2], 1.0 / step)
        return 0.1 * (command[:1] + lfilter(top, bottom, command - command[:1], axis=0))

    def found(measured, stated):
        rows = command[:, None], measured + slow[:, None] + NOISE[:, None]
        return {
            each.name for each in examined([Trial("made", *rows, stated, ("x",), simulate(rows[0], stated), "um", simulate)])[0]
        }

    assert found(simulate(command[:, None], STEP), STEP) == set()
    assert found(simulate(command[:, None], STEP, 24.0), STEP) == set()  # a heavier payload
    assert found(simulate(command[:, None], STEP), factor * STEP) == {"wrong_rate"}


def test_a_coarse_sensor_that_a_fast_command_moves_by_less_than_a_step_is_not_dead():
    chirp = 40.0 * np.sin(2 * np.pi * (0.2 + 12.0 * TIME) * TIME)
    coarse = np.round(answer(10.0 * answer(chirp, lag=0.05), lag=0.05) / 0.1) * 0.1 + 0.0
    assert np.ptp(coarse[1200:5400]) == 0.0  # most of the record, in which the command passes its range many times
    assert names(chirp, coarse) == [set(), set()]
    stuck = coarse.copy()
    stuck[400:1000] = stuck[400]
    assert names(chirp, stuck)[0] == {"dead_sensor"}


@pytest.mark.parametrize("tone", [False, True])
def test_a_delay_of_the_machine_is_no_other_rate_and_no_reversed_time(tone):
    random = np.random.default_rng(5)
    command = np.sin(2 * np.pi * 3.7 * TIME) if tone else sosfilt(butter(2, 0.05, output="sos"), random.standard_normal(len(TIME)))

    def simulate(command, step):
        return answer(command[:, 0], step)[:, None]

    for rows in (3, 6, 12, 30):
        late = np.concatenate([np.full(rows, command[0]), command[:-rows]])
        measured = simulate(late[:, None], STEP) + 0.01 * NOISE[:, None]
        trial = Trial("made", command[:, None], measured, STEP, ("x",), simulate(command[:, None], STEP), "um", simulate)
        names = {each.name for each in examined([trial])[0]}
        assert not names & {"wrong_rate", "reversed_time"}, (rows, names)


def test_rails_are_told_from_plateaus_that_belong_to_the_command():
    assert rails(COMMAND, MEASURED) is None
    stairs = np.repeat(np.random.default_rng(1).uniform(0, 100, 60), 100)
    assert rails(stairs, np.round(answer(stairs), 4)) is None
    value, share = rails(COMMAND, np.minimum(MEASURED, 8.5))
    assert value == 8.5 and share == pytest.approx(np.mean(MEASURED >= 8.5))


def test_a_staircase_is_no_held_command_and_a_plant_no_copy():
    assert held_samples(np.repeat(np.random.default_rng(1).uniform(0, 100, 600), 10)) == 1
    assert held_samples(np.repeat(COMMAND[::10], 10)) == 10
    assert copied_gain(COMMAND, MEASURED) is None
    assert copied_gain(COMMAND, 0.1 * COMMAND + NOISE) == pytest.approx(0.1, rel=1e-3)


def test_gaps_of_both_signals_are_counted():
    rows = np.delete(np.arange(len(TIME)), (np.arange(300, 5500, 400)[:, None] + np.arange(20)).ravel())
    assert simultaneous_gaps(COMMAND, MEASURED) == 0
    assert 5 <= simultaneous_gaps(COMMAND[rows], MEASURED[rows]) <= 14


def test_steps_of_a_converter_that_a_controller_passes_on_are_no_lost_rows():
    step, angular = 5e-5, 2 * np.pi * 420.0
    free, driven = np.array([[0.0, 1.0], [-(angular**2), -0.06 * angular]]), np.array([[0.0], [angular**2]])
    move, drive = cont2discrete((free, driven, np.eye(2), np.zeros((2, 1))), step)[:2]
    wanted = 4.0 + 3.0 * np.sin(2 * np.pi * 5.0 * step * np.arange(8000))
    command, measured = np.empty(8000), np.empty(8000)
    integral, state = 40.0, np.array([40.0, 0.0])
    for row, place in enumerate(wanted):
        measured[row] = 1e-3 * np.round(100.0 * state[0])
        integral += 600.0 * step * (place - measured[row])
        command[row] = integral + 3.0 * (place - measured[row])
        state = move @ state + drive[:, 0] * command[row]
    assert simultaneous_gaps(command[:-1], measured[1:]) == 0


def test_a_plant_without_dynamics_that_follows_a_rough_command_lost_no_rows():
    """The `diagnostic` excitation at 1 kHz is rough: a gain answers each of its jumps in the same row, or one later."""
    command = excitation("diagnostic", 1e3, lowest=0, highest=100, duration=1.0).ravel()
    noise = np.random.default_rng(0).normal(0, 0.002, len(command))
    for measured in (0.1 * command, 0.1 * np.append(command[:1], command[:-1])):
        assert simultaneous_gaps(command, measured + noise) == 0


def test_implausible_ranges_name_the_smaller_unit():
    assert implausible(COMMAND, MEASURED, "um") is None
    assert implausible(COMMAND, 1e3 * MEASURED, "um")[1] == "nm"


def test_a_binary_command_that_its_noisy_measurement_tells_exactly_is_not_exchanged_with_it():
    """Play operators cut the noise off two levels, so that an inverse leaves less of the command than the plant does of the measurement."""
    random = np.random.default_rng(4)
    command = np.repeat(random.choice([-1.0, 1.0], len(TIME) // 5), 5)
    top, bottom = bilinear([1.0], [0.0017, 1.0], 1.0 / STEP)  # a smooth source's, which answers in the same row
    measured = lfilter(top, bottom, command) + 0.018 * random.standard_normal(len(TIME))
    assert names(command, measured)[0] == set()


def test_axes_that_ring_on_while_the_other_is_driven_are_not_exchanged():
    """The second axis follows the first command alone, and the first rings while only the second command moves."""
    random = np.random.default_rng(6)
    pole = 2 * np.pi * 4.0
    top, bottom = bilinear([pole**2], [1.0, 0.03 * pole, pole**2], 1.0 / STEP)
    half = len(TIME) // 2
    commands = np.zeros((len(TIME), 2))
    commands[:half, 0] = sosfilt(butter(2, 0.1, output="sos"), random.standard_normal(half))
    commands[half:, 1] = np.sin(2 * np.pi * 90.0 * TIME[half:])  # beyond what the plant answers
    first = lfilter(top, bottom, commands[:, 0])
    measured = np.stack([first, -2.0 * answer(commands[:, 0])], axis=1) + 1e-3 * random.standard_normal(commands.shape)
    found = examined([Trial("made", commands, measured, STEP, ("x", "y"))])[0]
    assert not {each.name for each in found} & {"swapped_axes"}


def test_a_drift_larger_than_the_motion_is_no_unplugged_sensor():
    rows = np.arange(1600)
    command = np.sin(2 * np.pi * rows / 100)
    drift = 2.0 * (rows / 1600) ** 1.5
    assert names(command, answer(command) + drift + NOISE[:1600])[0] == set()
    assert names(command, drift + NOISE[:1600])[0] == {"unplugged_sensor"}


@pytest.mark.parametrize("limit", [np.inf, 6.0])
def test_a_model_refutes_what_it_explains_less(limit):
    """Command and measurement of a closed loop tell each other either way; a model of the machine knows which one came first."""

    def simulate(command, step):
        return answer(command[:, 0], step, 0.05)[:, None]

    def made(command, measured):
        return trial(command, measured, simulated=simulate(command[:, None], STEP), simulate=simulate)

    sound = made(COMMAND, np.minimum(answer(COMMAND, lag=0.05), limit) + NOISE)
    assert all(refutes(sound, 0, name) for name in REFUTABLE) and not refutes(sound, 0, "dead_sensor")
    hum = made(COMMAND, np.sin(2 * np.pi * 50.0 * TIME))
    assert not refutes(hum, 0, "unrelated_measurement") and not refutes(hum, 0, "unplugged_sensor")
    backwards = made(COMMAND[::-1].copy(), sound.measurement[::-1, 0])
    assert not refutes(backwards, 0, "reversed_time")
    assert not refutes(made(COMMAND[::-1].copy(), sound.measurement[:, 0]), 0, "reversed_command")
    assert not refutes(made(sound.measurement[:, 0], COMMAND), 0, "swapped_signals")


def followed(command: np.ndarray) -> np.ndarray:
    """A lag of the command, with noise."""
    return lfilter([0.05], [1.0, -0.95], command) + 1e-3 * np.random.default_rng(1).standard_normal(len(command))


SMOOTH = 50.0 + lfilter([0.1], [1.0, -0.9], 30.0 * np.random.default_rng(5).standard_normal(6000))
SWITCHED = np.repeat(np.random.default_rng(2).choice([20.0, 80.0], 60), 100)


def test_samples_that_jump_out_of_the_motion_are_counted():
    sound = followed(SMOOTH)
    bad = sound.copy()
    bad[[700, 1500, 4000]] += [3.0, -2.0, 5.0]
    assert (outliers(SMOOTH, sound), outliers(SMOOTH, bad)) == (0, 3)
    ramp = np.linspace(0.0, 90.0, 6000)
    coarse = np.round(followed(ramp) / 0.5) * 0.5  # noise flips it between two values
    assert outliers(ramp, coarse) == 0
    steps = np.repeat([0.0, 40.0, 5.0, 60.0, 0.0, 50.0], 1000)  # each step overshoots for one sample
    overshooting = steps + 0.5 * np.diff(steps, prepend=0.0) + 1e-3 * np.random.default_rng(1).standard_normal(len(steps))
    assert outliers(steps, overshooting) == 0


@pytest.mark.parametrize("value", [0.0, None])
def test_a_sensor_that_drops_out_or_freezes_is_told(value):
    stuck = followed(SMOOTH)
    stuck[2000:2200] = stuck[2000] if value is None else value
    assert longest_stand(SMOOTH, followed(SMOOTH)) is None
    begin, count = longest_stand(SMOOTH, stuck)
    assert (begin, count) == (2000, 200)
    trial = Trial("r", SMOOTH[:, None], stuck[:, None], 1e-3, ("x",))
    assert "stuck_measurement" in {each.name for each in examined([trial])[1]}


def test_rounding_and_backlash_do_not_count_as_a_sensor_that_stands():
    for command in (SMOOTH, SWITCHED):
        assert longest_stand(command, np.round(followed(command) / 3.0) * 3.0) is None
        play, at = np.empty(len(command)), command[0]
        for k, u in enumerate(command):
            play[k] = at = min(max(at, u - 8.0), u + 8.0)
        assert longest_stand(command, lfilter([0.05], [1.0, -0.95], play)) is None
        assert longest_stand(command, play) is None
