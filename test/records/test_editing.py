# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Preparation of records, against closed forms: what is kept, what is removed, what is written down."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hyst_control as hc
from hyst_control.cli import main

RATE = 2000.0
TIME = np.arange(4000) / RATE


def made(command, measurement, **more):
    return hc.from_arrays(command, measurement, RATE, **more)


def wave(frequency, time=TIME):
    return np.sin(2 * np.pi * frequency * time)


def middle(record, topic="measurement"):
    """Values of a signal without the ends, where a filter knows too little."""
    values = record.signal(topic).values[:, 0]
    return values[len(values) // 8 : -len(values) // 8]


@settings(deadline=None, max_examples=20)
@given(rate=st.sampled_from([250.0, 800.0, 1000.0, 3000.0, 4000.0, 44100.0]), frequency=st.floats(1.0, 40.0))
def test_a_slow_sine_is_the_same_at_another_rate(rate, frequency):
    record = made(wave(frequency), 2 * wave(frequency), hold="foh").resample(rate)
    signal = record.signal("measurement")
    assert 1 / record.common_step(["measurement"]) == pytest.approx(rate)
    edge = len(signal.time) // 8
    np.testing.assert_allclose(signal.values[edge:-edge, 0], 2 * wave(frequency, signal.time)[edge:-edge], atol=0.01)
    np.testing.assert_allclose(2 * middle(record, "command"), middle(record), atol=1e-9)


def test_a_lower_rate_keeps_out_what_it_cannot_carry():
    record = made(wave(10), wave(10) + wave(700)).resample(500)  # 700 Hz would appear at 200 Hz
    time = record.signal("measurement").time
    np.testing.assert_allclose(middle(record), wave(10, time)[len(time) // 8 : -len(time) // 8], atol=0.01)
    assert record.hold == "foh"


def test_a_held_command_stays_held_at_a_higher_rate():
    steps = np.repeat([0.0, 5.0, 2.0, 2.0], 1000)
    record = made(steps, steps).resample(6000)
    np.testing.assert_array_equal(record.signal("command").values[:, 0], np.repeat(steps, 3))
    assert record.hold == "zoh"


def test_a_filter_keeps_the_relation_and_the_phase():
    record = made(wave(20) + wave(600), wave(20) + wave(600)).filter(low_pass=100)
    np.testing.assert_allclose(middle(record), wave(20)[500:-500], atol=0.005)
    np.testing.assert_array_equal(record.signal("command").values, record.signal("measurement").values)
    at_the_corner = middle(made(wave(100), wave(100)).filter(low_pass=100))
    np.testing.assert_allclose(at_the_corner, 0.5 * wave(100)[500:-500], atol=0.005)
    both = middle(made(wave(1), wave(50) + wave(1) + wave(600)).filter(200, 10))
    np.testing.assert_allclose(both, wave(50)[500:-500], atol=0.05)


def test_offset_and_drift_are_removed_from_the_measurement_alone():
    record = made(wave(20) + 3, wave(20) + 7 - 2 * TIME)
    line = np.polynomial.Polynomial.fit(TIME, wave(20) + 7 - 2 * TIME, 1)
    due = wave(20) + 7 - 2 * TIME - line(TIME)
    np.testing.assert_allclose(record.detrend().signal("measurement").values[:, 0], due, atol=1e-9)
    assert abs(record.detrend("constant").signal("measurement").values.mean()) < 1e-12
    np.testing.assert_array_equal(record.detrend().signal("command").values, record.signal("command").values)


@settings(deadline=None, max_examples=20)
@given(rows=st.sets(st.integers(5, 3990), min_size=1, max_size=12), size=st.floats(0.5, 1e6), seed=st.integers(0, 99))
def test_outliers_go_and_all_else_stays(rows, size, seed):
    clean = 4 * wave(5) + 1e-3 * np.random.default_rng(seed).standard_normal(len(TIME))
    spoiled, rows = clean.copy(), [row for row in rows if not rows & set(range(row - 20, row))]
    spoiled[rows] += size
    record = made(wave(5), spoiled).remove_outliers()
    found = record.signal("measurement").values[:, 0]
    others = np.setdiff1d(np.arange(len(TIME)), rows)
    np.testing.assert_array_equal(found[others], clean[others])
    np.testing.assert_allclose(found[rows], clean[rows], atol=0.02)
    assert record.history == (f"{len(rows)} outliers removed from measurement (beyond 8 standard deviations)",)


def test_steps_turning_points_and_a_ringing_mode_are_no_outliers():
    steps = np.repeat([0.0, 5.0, 2.0, 2.5], 1000)
    since = np.maximum(TIME - 0.5, 0.0)
    ringing = (TIME > 0.5) * (1 - np.exp(-30 * since) * np.cos(2 * np.pi * 150 * since))
    triangle = 10 * np.abs((TIME * 4) % 2 - 1)
    for measurement in (steps, ringing, triangle, np.round(100 * wave(3)) / 100):
        record = made(wave(5), measurement).remove_outliers()
        np.testing.assert_array_equal(record.signal("measurement").values[:, 0], measurement)


def test_the_response_to_a_jump_of_the_command_is_no_outlier():
    command = np.repeat([0.0, 5.0, 2.0, 2.5], 1000)
    measurement = command.copy()
    measurement[[1000, 2001]] += [4.0, -3.0]
    measurement[2500] += 3.0
    found = made(command, measurement).remove_outliers()
    assert np.flatnonzero(found.signal("measurement").values[:, 0] != measurement).tolist() == [2500]
    bare = made(command, measurement).remove_outliers(topics=("command",))
    np.testing.assert_array_equal(bare.signal("command").values[:, 0], command)


@pytest.mark.parametrize("ppm", [4000.0, -500.0])
def test_a_measurement_is_brought_to_the_clock_of_the_command(ppm):
    """A clock slower by so many ppm takes its n-th sample at n (1 + ppm)."""
    record = made(wave(20), wave(20, TIME * (1.0 + 1e-6 * ppm))).reclock(ppm)
    command, measurement = (record.signal(topic).values[:, 0] for topic in ("command", "measurement"))
    assert len(command) == len(measurement) == min(len(TIME), int((len(TIME) - 1) * (1.0 + 1e-6 * ppm)) + 1)
    np.testing.assert_array_equal(command, wave(20)[: len(command)])
    np.testing.assert_allclose(measurement[:-2], command[:-2], atol=1e-5)
    assert f"({ppm:g} ppm)" in record.history[0]


@pytest.mark.parametrize("ppm", [np.nan, 2e5])
def test_clocks_that_differ_by_a_tenth_are_none(ppm):
    with pytest.raises(hc.InputError, match="--clock"):
        made(wave(20), wave(20)).reclock(ppm)


def test_merged_records_are_two_stretches_on_one_clock():
    first, second = made(wave(5), wave(5)), made(wave(7), wave(7)).cut(0.5)
    parts = first.merge(second).aligned(allow_gaps=True)
    assert [len(part.time) for part in parts] == [4000, 3000]
    np.testing.assert_array_equal(parts[1].command, second.signal("command").values)
    with pytest.raises(hc.InputError, match="resample it"):
        first.merge(second.resample(500))


@pytest.mark.parametrize(
    ("edit", "words"),
    [
        (lambda record: record.resample(0), "rate: must be a ratio"),
        (lambda record: record.resample(RATE * np.sqrt(2)), "rate: must be a ratio"),
        (lambda record: record.filter(), "low_pass, high_pass: give one"),
        (lambda record: record.filter(1000.0), "low_pass: must be > 0 and < 1000 Hz"),
        (lambda record: record.filter(10, 100), "low-pass above the high-pass"),
        (lambda record: record.cut(0, 0.002).filter(10), "too short"),
        (lambda record: record.detrend("cubic"), "kind: must be linear or constant"),
        (lambda record: record.remove_outliers(window=4), "window: must be odd and >= 3 samples, got 4"),
        (lambda record: record.cut(5, 6), "no samples"),
        (lambda record: record.merge(record).detrend(), "ticks are missing"),
    ],
)
def test_what_makes_no_sense_is_refused(edit, words):
    with pytest.raises(hc.InputError, match=words):
        edit(made(wave(5), wave(5)))


def test_the_command_writes_what_the_methods_give_with_its_history(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    record = made(wave(20) + wave(600), wave(20) + wave(600))
    record.save("run")
    words = ["--from", "0.25", "--outliers", "--detrend", "constant", "--low-pass", "100", "--resample", "500"]
    assert main(["edit", "run", *words]) == 0
    found = hc.read_bag("run_edited")
    due = record.cut(0.25).remove_outliers().detrend("constant").filter(100).resample(500)
    np.testing.assert_allclose(found.signal("measurement").values, due.signal("measurement").values, atol=1e-12)
    assert found.history == due.history and len(due.history) == 5 and found.hold == "foh"
    assert all(step in capsys.readouterr().out for step in due.history[:1])
    assert main(["edit", "run", "--output", "same"]) == 2
    assert "nothing to do" in capsys.readouterr().err
