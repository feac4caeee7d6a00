# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Diagnosis of plain Python simulators with records made by SciPy: effects slower, later or larger than on the shipped machines."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter

import hyst_control as hc
from hyst_control.chain import Chain
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.diagnose.workflow import diagnose_records
from hyst_control.model_file import Model
from hyst_control.records.record import Record, Signal
from test.diagnose.conftest import all_but

RATE, ROWS = 1000.0, 4000
TIME = np.arange(ROWS) / RATE


def mode(rows, frequency, damping, static):
    w = 2 * np.pi * frequency
    top, bottom, _ = cont2discrete(([static * w * w], [1.0, 2 * damping * w, w * w]), 1 / RATE, "foh")
    return static * rows[0] + lfilter(np.ravel(top), bottom, rows - rows[0])


def simulate(command, sample_time, gain):
    return gain * np.append(command[0], command[:-1])


def slow(command, sample_time, gain, corner):
    """A lag that is as slow as many delays."""
    pole = np.exp(-corner * sample_time)
    return gain * (command[0] + lfilter([0.0, 1.0 - pole], [1.0, -pole], command - command[0]))


GAIN = {"gain": (0.1, 0.002, "um/V")}
LAG = {**GAIN, "corner": (10.0, 0.5, "1/s")}


def diagnosed(command, measured, simulator=simulate, parameters=GAIN):
    random = np.random.default_rng(5)
    record = hc.from_arrays(command, measured + 0.01 * random.standard_normal(ROWS), rate=RATE, hold="zoh")
    return hc.diagnose(record, simulator, parameters=parameters, verbose=False)


def values_of(found, name):
    """Parameters of the only effect that is named."""
    assert [effect["name"] for effect in found.document["effects"]] == [name]
    return {key: one["value"] for key, one in found.document["effects"][0]["parameters"].items()}


@pytest.mark.parametrize("frequency", [11.0, 47.0])
def test_a_mode_is_found_wherever_the_record_shows_ten_periods(frequency):
    """Both modes are slower than a fifth of the Nyquist frequency."""
    random = np.random.default_rng(2)
    lines = np.arange(1, 400)
    phases = random.uniform(0, 2 * np.pi, len(lines))
    command = 50.0 + 2.0 * np.cos(2 * np.pi * np.outer(TIME, lines / 4.0) + phases).sum(axis=1)
    truth = simulate(command, 1 / RATE, 0.1)
    found = diagnosed(command, truth + mode(truth, frequency, 0.02, 0.05))
    values = values_of(found, "resonance")
    assert values["frequency"] == pytest.approx(frequency, rel=0.01) and values["gain"] == pytest.approx(0.05, rel=0.15)


def test_a_delay_that_acts_where_the_command_rests_is_tested_without_an_error():
    """A fractional delay acts on rows at which the command is constant, so the test of its direction has nothing to compare."""
    command = np.repeat(np.random.default_rng(1).choice([10.0, 90.0], ROWS // 20), 20)
    truth = simulate(command, 1 / RATE, 0.1)
    found = diagnosed(command, 0.9 * truth + 0.1 * np.append(truth[0], truth[:-1]))
    assert values_of(found, "delay")["tau"] == pytest.approx(1e-4, rel=0.05)


@pytest.mark.parametrize("rows", [8, 120])
def test_a_delay_of_any_length_is_a_delay(rows):
    """Of steps of equal length: a hold over 10 rows would take each of them 8 rows late."""
    command = np.repeat(np.random.default_rng(4).uniform(10.0, 90.0, 20), ROWS // 20)
    late = np.append(np.full(rows, command[0]), command[:-rows])
    found = diagnosed(command, slow(late, 1 / RATE, 0.1, 10.0), slow, LAG)
    assert values_of(found, "delay")["tau"] == pytest.approx(rows / RATE, rel=0.02)


@pytest.mark.parametrize("samples", [9, 10, 37])
def test_a_hold_that_does_more_than_to_delay_is_a_hold(samples):
    command = np.interp(TIME, np.linspace(0.0, TIME[-1], 30), np.random.default_rng(4).uniform(10.0, 90.0, 30))
    held = command[np.arange(ROWS) // samples * samples]
    assert values_of(diagnosed(command, slow(held, 1 / RATE, 0.1, 10.0), slow, LAG), "dac_hold")["samples"] == samples


def test_a_gain_may_drift_by_half():
    command = 50.0 + 40.0 * np.sin(2 * np.pi * 2.0 * TIME) * np.cos(2 * np.pi * 0.7 * TIME)
    truth = slow(command, 1 / RATE, 0.1, 10.0) * (1.0 + 0.5 * TIME / TIME[-1])
    assert values_of(diagnosed(command, truth, slow, LAG), "gain_drift")["change"] == pytest.approx(0.5, rel=0.02)


PAIR = {"gx": (0.1, 0.002, "um/V"), "gy": (0.08, 0.002, "um/V"), "fx": (60.0, 1.0, "Hz"), "fy": (75.0, 1.0, "Hz")}


def test_a_dead_zone_need_not_be_where_the_command_crosses_zero():
    random = np.random.default_rng(3)
    command = 6.0 * np.sin(2 * np.pi * 2.3 * TIME) + 2.0 * random.standard_normal(40).repeat(ROWS // 40)
    within = command - np.clip(command + 2.0, -0.6, 0.6)
    values = values_of(diagnosed(command, simulate(within, 1 / RATE, 0.1)), "dead_zone")
    assert values["half_width"] == pytest.approx(0.6, rel=0.05) and values["center"] == pytest.approx(-2.0, abs=0.1)


def test_a_stretch_that_stands_still_is_no_obstacle():
    """Every fourth sample of the record is held, and its second stretch comes to rest at once."""
    random = np.random.default_rng(4)
    command = np.concatenate([30.0 * random.standard_normal(300).repeat(10), np.linspace(0.0, 20.0, 50), np.full(450, 20.0)])
    measured = simulate(command, 1 / RATE, 0.1)
    measured[:3000] += 0.01 * random.standard_normal(3000)
    measured[4:3000:4] = measured[3:2999:4]
    time = np.arange(3500) / RATE + np.where(np.arange(3500) < 3000, 0.0, 1.0)
    signals = {"command": Signal(time, command[:, None], ("x",), "V"), "measurement": Signal(time, measured[:, None], ("x",), "um")}
    model = Model("gain", ("x",), {"command": "V", "measurement": "um"}, 1 / RATE, Chain((TransferFunction([0.1], [0.004, 1.0]),)))
    document = diagnose_records([Record(signals, "stopped", start="unknown")], model).document
    assert "held_samples" in [effect["name"] for effect in document["effects"]]


def pair(command, sample_time, gx, gy, fx, fy):
    """Two axes, each with a mode, exact for a held command."""
    found = []
    for rows, gain, frequency in zip(command.T, (gx, gy), (fx, fy), strict=True):
        w = 2 * np.pi * frequency
        top, bottom, _ = cont2discrete(([gain * w * w], [1.0, 0.4 * w, w * w]), sample_time, "zoh")
        found.append(gain * rows[0] + lfilter(np.ravel(top), bottom, rows - rows[0]))
    return np.column_stack(found)


@pytest.mark.parametrize("shares", [(0.03, 0.0), (0.03, -0.02)])
def test_a_static_share_of_the_other_axis_is_no_mode_beyond_the_command(shares):
    """The machine runs eight steps to a sample, and differs from the simulator by what these are: a mode makes that as well."""
    random = np.random.default_rng(8)
    command = np.cumsum(random.standard_normal((ROWS, 2)), axis=0)
    command = lfilter([0.05], [1.0, -0.95], command - command.mean(axis=0), axis=0)
    command *= 40.0 / np.abs(command).max(axis=0)
    fine = pair(np.repeat(command, 8, axis=0), 1 / RATE / 8, 0.1012, 0.0795, 60.4, 74.5)[::8]
    measured = fine + fine[:, ::-1] * np.array(shares) + 0.003 * random.standard_normal((ROWS, 2))
    found = hc.diagnose(hc.from_arrays(command, measured, rate=RATE), pair, parameters=PAIR, verbose=False)
    values = values_of(found, "cross_coupling")
    for axis, share in zip("xy", shares, strict=True):
        assert values.get(f"coupling_{axis}", values["coupling"] if share else 0.0) == pytest.approx(share, abs=0.001)


def test_a_limit_that_the_command_hardly_reaches_is_not_told():
    random = np.random.default_rng(6)
    command = lfilter([0.02], [1.0, -0.98], random.standard_normal(ROWS))
    command = 50.0 + 40.0 * command / np.abs(command).max()
    fine = np.clip(np.repeat(command, 8), None, 70.0)
    lagged = slow(fine, 1 / RATE / 8, 0.1, 300.0)[::8]
    found = diagnosed(command, lagged, slow, {**GAIN, "corner": (300.0, 3.0, "1/s")})
    values = values_of(found, "saturation")
    assert values["upper"] == pytest.approx(70.0, rel=0.01) and "lower" not in values


STEPS_OF_COMMAND = np.repeat(np.append(0.0, np.random.default_rng(6).uniform(-8.0, 8.0, ROWS // 20 - 1)), 20)


def resonant(command, sample_time, frequency):
    """A mode of a held command, at a tenth of the rate."""
    w = 2 * np.pi * frequency
    top, bottom, _ = cont2discrete(([w * w], [1.0, 0.1 * w, w * w]), sample_time)
    return lfilter(np.ravel(top), bottom, command)


MODE = {"frequency": (100.0, 1.0, "Hz")}


def fine(command, times=20):
    """A command held at finer steps."""
    return np.repeat(command, times)


@pytest.mark.parametrize("ticks", [0.5, 1.35])
def test_a_delay_of_a_part_of_a_tick_before_a_fast_mode(ticks):
    rows, late = fine(STEPS_OF_COMMAND), round(20 * ticks)
    measured = resonant(np.append(np.full(late, rows[0]), rows[:-late]), 1 / RATE / 20, 100.4)[::20]
    found = diagnosed(STEPS_OF_COMMAND, measured, resonant, MODE)
    assert values_of(found, "delay")["tau"] == pytest.approx(ticks / RATE, rel=0.02)


def test_a_lag_before_a_linear_function_is_as_well_one_behind_it():
    """And either has the cutoff of the machine, which is a fifth of the rate."""
    pole = np.exp(-2 * np.pi * 200.0 / RATE / 20)
    measured = lfilter([0.5 * (1.0 - pole)] * 2, [1.0, -pole], resonant(fine(STEPS_OF_COMMAND), 1 / RATE / 20, 30.1))[::20]
    found = diagnosed(STEPS_OF_COMMAND, measured, resonant, {"frequency": (30.0, 0.5, "Hz")})
    cutoffs = {effect["name"]: effect["parameters"]["cutoff"]["value"] for effect in found.document["effects"]}
    assert cutoffs == {name: pytest.approx(200.0, rel=0.02) for name in ("amplifier_lowpass", "sensor_lowpass")}


def test_a_parameter_that_is_off_is_told_with_its_value(tmp_path):
    pytest.importorskip("pandas")
    found = diagnosed(STEPS_OF_COMMAND, simulate(STEPS_OF_COMMAND, 1 / RATE, 0.11))
    (row,) = found.document["parameters"]
    assert row["ci90"][0] < 0.11 < row["ci90"][1] and (row["nominal"], row["unit"]) == (0.1, "um/V")
    assert re.search(
        r"parameters: gain is 0\.1[01]\d* ± \S+ um/V, the model has 0\.1 \(\+5\.0 σ of its tolerance\)\.", found.summary()
    )
    frame = found.to_frame().set_index("parameter").loc["gain"]
    assert (frame["value"], frame["nominal"], frame["unit"]) == (row["value"], 0.1, "um/V")
    found.save(tmp_path / "gap.html")
    assert len(re.findall(r"0\.1[01]\d* ± \S+ um/V", (tmp_path / "gap.html").read_text())) == 2


def test_a_command_in_ampere_is_told_in_ampere(tmp_path):
    dead = np.sign(STEPS_OF_COMMAND) * np.maximum(np.abs(STEPS_OF_COMMAND) - 0.4, 0.0)
    noise = 0.01 * np.random.default_rng(5).standard_normal(ROWS)
    record = hc.from_arrays(STEPS_OF_COMMAND, resonant(dead, 1 / RATE, 30.0) + noise, rate=RATE, command_unit="A", unit="V")
    found = hc.diagnose(record, resonant, parameters={"frequency": (30.0, 0.5, "Hz")}, without=all_but("dead_zone"), verbose=False)
    assert found.document["effects"][0]["parameters"]["half_width"]["unit"] == "A"
    assert re.search(r"dead zone of ±0\.(4|39\d|40\d) A in the drive", found.summary())
    found.save(tmp_path / "gap.html")
    assert "command [A]" in (tmp_path / "gap.html").read_text()


def leaving(command, sample_time, gain):
    raise SystemExit("no license")


RECORD = hc.from_arrays(STEPS_OF_COMMAND, simulate(STEPS_OF_COMMAND, 1 / RATE, 0.1), rate=RATE)


@pytest.mark.parametrize(
    ("records", "model", "more", "said"),
    [
        (simulate, RECORD, {}, "records: function is no Record: make one by"),
        (STEPS_OF_COMMAND, simulate, {}, "records: ndarray is no Record"),
        ("record", simulate, {}, "records: str is no Record"),
        ([RECORD, "record"], simulate, {}, "records: str is no Record"),
        (RECORD, simulate, {"baseline": "record"}, "baseline: str is no Record"),
        (RECORD, simulate, {"warm_up": "0.1"}, "warm_up: must be a number >= 0 s, got '0.1'"),
        (RECORD, simulate, {"without": ["dellay"]}, "without: 'dellay' is not an effect: use one of dac_hold, delay"),
        (RECORD, simulate, {"without": "delay"}, r"without: 'delay', must be a list of effects: give \['delay'\]"),
        (RECORD, leaving, {}, "simulator leaving: SystemExit: no license: mend it, and try"),
        (RECORD, lambda command, sample_time, gain: 1j * command, {}, "complex values: return real ones"),
    ],
)
def test_a_careless_call_is_one_line(records, model, more, said):
    with pytest.raises(hc.InputError, match=said) as raised:
        hc.diagnose(records, model, parameters=GAIN, verbose=False, **more)
    assert "\n" not in str(raised.value)


def test_a_baseline_may_be_one_record():
    few = all_but("delay")
    one, several = (
        hc.diagnose(RECORD, simulate, given, parameters=GAIN, without=few, verbose=False) for given in (RECORD, [RECORD])
    )
    assert one.document == several.document
