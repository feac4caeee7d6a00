# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Baseline records beside the new one, on a machine that the model is not: other hysteresis, creep, a mode of another frequency."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import CubicSpline
from scipy.signal import bilinear, lfilter, lfilter_zi

from hyst_control.base.errors import InputError
from hyst_control.chain import Chain, Sampling
from hyst_control.chain.hysteresis.prandtl_ishlinskii import PrandtlIshlinskii
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.chain.memoryless import Gain
from hyst_control.diagnose.configuration import CONFIGURATION
from hyst_control.diagnose.model_error.same_command import matching
from hyst_control.diagnose.noise.denoised_error import without_noise
from hyst_control.diagnose.problem.per_record_stages import CarriedError, SessionZero
from hyst_control.diagnose.problem.problem import Piece
from hyst_control.diagnose.report.document import sentence
from hyst_control.diagnose.validate.predictability import predictable_share
from hyst_control.diagnose.workflow import diagnosed
from hyst_control.model_file import Model
from hyst_control.records.record import Record, Signal
from test.diagnose.conftest import all_but

pytestmark = pytest.mark.long_file

RATE = 5000.0
SETTINGS = CONFIGURATION.baseline
WITHOUT = all_but(
    *("delay", "sensor_lowpass", "amplifier_lowpass", "gain", "offset", "offset_drift", "gain_drift", "creep", "resonance"),
    *("hysteresis_width", "sensor_nonlinearity"),
)


def sines(frequency: float, cycles: int = 5) -> np.ndarray:
    """A bipolar sine whose amplitude falls from cycle to cycle, between two rests."""
    count = int(RATE * cycles / frequency)
    time = np.arange(count) / RATE
    envelope = np.interp(time, np.arange(cycles + 1) / frequency, 80.0 * 0.75 ** np.arange(cycles + 1))
    rest = np.zeros(int(0.02 * RATE))
    return np.concatenate([rest, envelope * np.sin(2 * np.pi * frequency * time), rest])


def bouc_wen(u: np.ndarray) -> np.ndarray:
    """Bouc-Wen hysteresis of commands (N,) in V: displacements, um."""
    z, found = 0.0, np.empty(len(u))
    for k in range(len(u)):
        step = u[k] - u[k - 1] if k else 0.0
        z += 0.35 * step - 0.018 * abs(step) * z - 0.006 * step * abs(z)
        found[k] = 0.03 * u[k] - 0.03 * z + 2e-5 * u[k] ** 2
    return found


def machine(command: np.ndarray, seed: int, drive=lambda u: u, sensor=lambda y: y) -> np.ndarray:
    """Bouc-Wen hysteresis, creep, a mode of 430 Hz, a zero and a slow drift of each session, noise; written for this test alone."""
    random, u = np.random.default_rng(seed), drive(command)
    hysteresis = bouc_wen(u)
    keep = np.exp(-1.0 / RATE / 0.1)
    creeping = hysteresis + 0.02 * lfilter([1.0 - keep], [1.0, -keep], hysteresis)
    mode = bilinear([(2 * np.pi * 430.0) ** 2], [1.0, 0.06 * 2 * np.pi * 430.0, (2 * np.pi * 430.0) ** 2], RATE)
    zero, drift = 0.1 * random.standard_normal(2)
    time = np.linspace(-1.0, 1.0, len(u))
    return sensor(lfilter(*mode, creeping) + zero + 0.2 * drift * time) + 0.002 * random.standard_normal(len(u))


def lowpass(cutoff: float, order: int):
    def through(y: np.ndarray) -> np.ndarray:
        b, a = bilinear([2 * np.pi * cutoff], [1.0, 2 * np.pi * cutoff], RATE)
        for _ in range(order):
            y = lfilter(b, a, y, zi=lfilter_zi(b, a) * y[0])[0]
        return y

    return through


def behind(y: np.ndarray) -> np.ndarray:
    """1 from 0.0826 s on."""
    return (np.arange(len(y)) > 413).astype(float)


def late(tau: float):
    def through(y: np.ndarray) -> np.ndarray:
        time = np.arange(len(y)) / RATE
        return CubicSpline(time, y)(np.maximum(time - tau, 0.0))

    return through


def record(command: np.ndarray, measurement: np.ndarray, source: str) -> Record:
    time = np.arange(len(command)) / RATE
    signals = {
        "command": Signal(time, command[:, None], ("x",), "V"),
        "measurement": Signal(time, measurement[:, None], ("x",), "um"),
    }
    return Record(signals, source)


def fitted() -> Model:
    """A Prandtl-Ishlinskii model fitted to a slow baseline record by least squares, in front of a mode at 400 Hz: near, and wrong."""
    command, thresholds = sines(20.0), (4.0, 10.0, 20.0, 35.0, 55.0)
    columns = [command, np.ones(len(command))]
    for threshold in thresholds:
        running = PrandtlIshlinskii((threshold,), (1.0,)).filter(Sampling(1.0 / RATE, 1, "foh"))
        running.settle(command[:1])
        columns.append(running.process(command[:, None])[:, 0])
    weights = np.linalg.lstsq(np.stack(columns, axis=1), machine(command, 0), rcond=None)[0]
    mode = (2 * np.pi * 400.0) ** 2
    chain = Chain(
        (PrandtlIshlinskii(thresholds, tuple(weights[2:]), w0=weights[0]), TransferFunction((mode,), (1.0, 0.08 * mode**0.5, mode)))
    )
    return Model("near", ("x",), {"command": "V", "measurement": "um"}, 1.0 / RATE, chain)


CASES = {  # what is done to the machine, the names that fit, the parameter and its true value
    "delay of the sensor": ({"sensor": late(2e-3)}, {"delay"}, "tau", 2e-3),
    "delay of a part of a sample": ({"sensor": late(0.28e-3)}, {"delay"}, "tau", 0.28e-3),
    "delay of the drive": ({"drive": late(2e-3)}, {"delay"}, "tau", 2e-3),
    "low-pass": ({"sensor": lowpass(80.0, 1)}, {"sensor_lowpass", "amplifier_lowpass"}, "cutoff", 80.0),
    "low-pass of second order": ({"sensor": lowpass(80.0, 2)}, {"sensor_lowpass", "amplifier_lowpass"}, "cutoff", 80.0),
    "gain": ({"sensor": lambda y: 1.05 * y}, {"gain"}, "gain", 0.05),
    "gain that jumps": ({"sensor": lambda y: y * (1.0 + 0.05 * behind(y))}, {"gain_drift"}, "change", 0.05),
    "zero that jumps": ({"sensor": lambda y: y - 0.2 * behind(y)}, {"offset_drift"}, "onset", 0.0826),
}


MODEL = fitted()


@pytest.mark.parametrize("name", CASES)
def test_a_change_is_named_beside_a_clean_record_of_the_same_command(name):
    change, names, parameter, value = CASES[name]
    command = sines(50.0)
    new, clean = record(command, machine(command, 1, **change), "new"), record(command, machine(command, 2), "clean")
    report, *_ = diagnosed([new], MODEL, cache=False, baseline=[clean], without=WITHOUT)
    first = report["effects"][0]
    assert report["verdict"] == "effect" and first["name"] in names
    assert first["parameters"][parameter]["value"] == pytest.approx(value, rel=0.06)
    if "order" in name:
        assert first["parameters"]["order"]["value"] == 2.0
    assert first["shrink"] > 0.95
    assert report["baseline"]["same_command"]


@pytest.mark.parametrize("factor", [1.02, 1.04])
def test_a_healthy_machine_at_a_similar_command_has_no_gap(factor):
    """The model error changes with the command, here scaled as by a control loop after a gain change."""
    command = sines(50.0)
    new, clean = record(factor * command, machine(factor * command, 1), "new"), record(command, machine(command, 2), "clean")
    report, *_ = diagnosed([new], MODEL, cache=False, baseline=[clean], without=WITHOUT)
    assert report["verdict"] == "no_gap"
    late_by = record(factor * command, machine(factor * command, 1, sensor=late(2e-3)), "new")
    report, *_ = diagnosed([late_by], MODEL, cache=False, baseline=[clean], without=WITHOUT)
    assert report["verdict"] == "effect" and report["effects"][0]["name"] == "delay"
    assert report["effects"][0]["parameters"]["tau"]["value"] == pytest.approx(2e-3, rel=0.1)


@pytest.mark.parametrize("seed", [0, 2])
def test_a_drift_of_a_whole_range_is_no_session_where_an_effect_explains_the_record(seed):
    """A slew limit on a single slow climb: a parabola of a session's zero resembles it."""
    random, time = np.random.default_rng(seed), np.arange(int(2.0 * RATE)) / RATE
    levels = np.append(0.0, np.cumsum(random.uniform(2.0, 14.0, 5)))
    command = np.interp(time, np.linspace(0.0, 2.0, 13), np.append(levels, levels[-1] + random.uniform(-8.0, 8.0, 7)))
    most = 0.5 * np.abs(np.diff(command)).max()

    def limited(u):
        found = u.copy()
        for k in range(1, len(u)):
            found[k] = found[k - 1] + np.clip(u[k] - found[k - 1], -most, most)
        return found

    clean = [record(sines(frequency), machine(sines(frequency), 9), f"{frequency} Hz") for frequency in (20.0, 50.0)]
    new = record(command, machine(command, 1, drive=limited), "new")
    without = [name for name in WITHOUT if name != "slew_limit"]
    report, *_ = diagnosed([new], MODEL, cache=False, baseline=clean, without=without)
    first = report["effects"][0]
    assert first["name"] == "slew_limit" and first["parameters"]["rate"]["value"] == pytest.approx(most * RATE, rel=0.1)


def test_a_clean_record_shows_its_session_at_most():
    command = sines(50.0)
    new, clean = record(command, machine(command, 3), "new"), record(command, machine(command, 4), "clean")
    report, *_ = diagnosed([new], MODEL, cache=False, baseline=[clean])
    assert report["verdict"] in ("no_gap", "effect")
    assert {effect["name"] for effect in report["effects"]} <= {"offset", "offset_drift"}
    zero = next(row for row in report["companions"] if row["name"] == "offset")
    true = [0.1 * np.random.default_rng(seed).standard_normal(2)[0] for seed in (3, 4)]
    assert zero["value"] == pytest.approx(true[0] - true[1], abs=0.005)


@pytest.mark.parametrize("gain", [1.002, 1.01])
def test_what_sessions_usually_differ_by_is_no_effect_beside_a_single_clean_record(gain):
    """A gain of two thousandths: one baseline record without a period does not tell whether the next one has it too."""
    command = sines(50.0)
    new, clean = (
        record(command, machine(command, 1, sensor=lambda y: gain * y), "new"),
        record(command, machine(command, 2), "clean"),
    )
    report, *_ = diagnosed([new], MODEL, cache=False, baseline=[clean], without=WITHOUT)
    names = [effect["name"] for effect in report["effects"]]
    assert (report["verdict"] == "no_gap" and not names) if gain < 1.005 else names[0] == "gain"


def test_a_usual_session_is_no_effect():
    command = sines(50.0)
    clean = [record(command, machine(command, seed), "clean") for seed in range(10, 15)]
    report, *_ = diagnosed([record(command, machine(command, 3), "new")], MODEL, cache=False, baseline=clean)
    assert report["verdict"] == "no_gap" and not report["effects"]


def test_clean_records_of_other_commands_tell_the_model_from_the_machine():
    command, others = sines(25.0), [sines(20.0), sines(35.0)]
    clean = [record(other, machine(other, seed), "clean") for seed, other in enumerate(others)]
    changed = record(command, machine(command, 7, sensor=lowpass(15.0, 1)), "new")
    report, *_ = diagnosed([changed], MODEL, cache=False, baseline=clean, without=WITHOUT)
    assert not report["baseline"]["same_command"] and report["verdict"] in ("effect", "ambiguous")
    found = next(effect for effect in report["effects"] if effect["name"] in {"sensor_lowpass", "amplifier_lowpass"})
    assert found["parameters"]["cutoff"]["value"] == pytest.approx(15.0, rel=0.15)


def test_a_new_clean_record_of_another_command_is_no_gap():
    command, others = sines(50.0), [sines(20.0), sines(45.0)]
    clean = [record(other, machine(other, seed), "clean") for seed, other in enumerate(others)]
    report, *_ = diagnosed([record(command, machine(command, 8), "new")], MODEL, cache=False, baseline=clean)
    assert {effect["name"] for effect in report["effects"]} <= {"offset", "offset_drift"}


@pytest.mark.parametrize(
    ("change", "names", "taken_off"), [({}, set(), 0.0), ({"sensor": late(8e-3)}, {"delay"}, 0.0), ({}, set(), 40.0)]
)
def test_a_sensor_may_have_its_zero_anywhere(change, names, taken_off):
    """Many times the range away in every session: that says nothing of an effect, and is usual, and so is no zero at all."""
    away, command, others = 40.0, sines(25.0), [sines(20.0), sines(35.0)]
    clean = [record(other, machine(other, seed) + away, "clean") for seed, other in enumerate(others)]
    report, *_ = diagnosed(
        [record(command, machine(command, 7, **change) + away - taken_off, "new")],
        MODEL,
        cache=False,
        baseline=clean,
        without=all_but("delay", "gain", "offset", "offset_drift", "gain_drift", "creep", "sensor_lowpass", "sensor_nonlinearity"),
    )
    found = {effect["name"]: effect for effect in report["effects"]}
    assert set(found) >= names and not report["baseline"]["same_command"]
    assert report["verdict"] in (("effect", "ambiguous") if names else ("no_gap",))
    if names:
        assert found["delay"]["parameters"]["tau"]["value"] == pytest.approx(8e-3, rel=0.15)
    zero = next(row for row in report["companions"] if row["name"] == "offset")
    assert abs(zero["value"]) < zero["usual"] < 2.0
    if taken_off == 0.0:  # what the clean sessions have is no part of the gap; what this session has besides is told
        assert report["gap"]["rms"] < 0.05 * away
        told = re.search(r" differ by ([\d.]+) um rms .*; ([\d.]+) um with the session's zero", sentence(report))
        if not names:
            assert told and float(told[1]) < float(told[2]) == pytest.approx(report["gap"]["rms"], rel=0.01)


@pytest.mark.parametrize("frequencies", [(50.0, 50.0), (40.0, 50.0)])
def test_what_fills_the_memory_of_a_clean_record_is_no_error_of_the_model(frequencies):
    """A record that begins anywhere: its warm-up counts neither for the error of the model nor for what differs between periods."""
    begin, command = 0.1, [80.0 * np.sin(2 * np.pi * f * np.arange(2500) / RATE) for f in frequencies]
    transient = 3.0 * np.exp(-np.arange(2500) / RATE / 0.005) * np.sin(2 * np.pi * 130.0 * np.arange(2500) / RATE)
    found = []
    for added in (0.0, transient):
        clean = [record(command[0], machine(command[0], 2) + added, "clean")]
        new = record(command[1], machine(command[1], 1), "new")
        report, *_ = diagnosed([new], MODEL, cache=False, baseline=clean, warm_up=begin, without=all_but("gain"))
        found.append(report["baseline"]["repeatability"][0])
    assert found[1] == pytest.approx(found[0], rel=0.1)


def test_without_a_model_a_clean_record_says_what_has_changed():
    command = sines(50.0)
    new, clean = record(command, machine(command, 1, sensor=lowpass(80.0, 1)), "new"), record(command, machine(command, 2), "clean")
    report, *_ = diagnosed([new], None, cache=False, baseline=[clean])
    assert report["effects"][0]["name"] == "sensor_lowpass"
    assert report["effects"][0]["parameters"]["cutoff"]["value"] == pytest.approx(80.0, rel=0.06)


def test_refusals():
    command, other = sines(50.0), sines(20.0)
    new = record(command, machine(command, 1), "new")
    with pytest.raises(InputError, match="needs a model or a baseline"):
        diagnosed([new], None)
    with pytest.raises(InputError, match="no clean record has the new record's command"):
        diagnosed([new], None, baseline=[record(other, machine(other, 2), "clean")])


@settings(max_examples=30, deadline=None)
@given(shift=st.integers(0, 60), length=st.integers(200, 400))
def test_the_same_command_is_found_up_to_a_shift(shift, length):
    random = np.random.default_rng(shift * 1000 + length)
    command = np.cumsum(random.standard_normal((500, 1)), axis=0)
    part = command[shift : shift + length]
    found = matching(part, [Piece(command, command)], SETTINGS.same_command, SETTINGS.overlap)
    assert [match.shift for match in found] == [shift]
    other = Piece(command + random.standard_normal(command.shape), command)
    assert not matching(part, [other], SETTINGS.same_command, SETTINGS.overlap)


@settings(max_examples=20, deadline=None)
@given(cuts=st.lists(st.integers(1, 99), max_size=5), hold=st.sampled_from(["zoh", "foh"]), record_index=st.integers(0, 1))
def test_stages_of_a_session_change_no_bit_when_a_signal_is_cut(cuts, hold, record_index):
    random = np.random.default_rng(0)
    signal = random.standard_normal((100, 2))
    sizes = ((1.0, 1.0, 1.0), (2.0, 3.0, 2.0))
    zero = SessionZero(random.standard_normal((2, 2, 3)), sizes, (0.1, 0.2), random.standard_normal((2, 2, 3)))
    carried = CarriedError((random.standard_normal((100, 2)), random.standard_normal((60, 2))))
    for stage in (zero.for_record(record_index), carried.for_record(record_index)):
        whole, parts = stage.filter(Sampling(1e-3, 2, hold)), stage.filter(Sampling(1e-3, 2, hold))
        assert (whole.settle(signal[0]) == parts.settle(signal[0])).all()
        blocks = np.split(signal, sorted(set(cuts)))
        assert (whole.process(signal) == np.concatenate([parts.process(block) for block in blocks])).all()


def test_a_remainder_that_follows_the_command_is_predictable_and_noise_is_not():
    random, command = np.random.default_rng(1), sines(20.0)[:, None]
    walk = np.cumsum(random.standard_normal(command.shape), axis=0)
    follows = 0.3 * (command / 80.0) ** 3
    assert predictable_share([command], [follows], 10) > 0.99
    assert predictable_share([command], [random.standard_normal(command.shape)], 10) < 0.05
    assert predictable_share([command], [walk], 10) < 0.3
    assert 0.4 < predictable_share([command], [follows / follows.std() + random.standard_normal(command.shape)], 10) < 0.6


def test_what_comes_back_with_every_period_follows_the_command_whatever_a_regression_finds():
    """A pattern without any relation to the command's features, in noise of its size: half of the energy comes back."""
    random, periods, rows = np.random.default_rng(2), 8, 500
    command = np.tile(np.sin(2.0 * np.pi * np.arange(rows) / rows), periods)[:, None]
    pattern, noise = np.tile(random.standard_normal(rows), periods)[:, None], random.standard_normal((periods * rows, 1))
    assert predictable_share([command], [pattern], 10) > 0.98
    assert predictable_share([command], [pattern + noise], 10) == pytest.approx(0.5, abs=0.05)
    assert predictable_share([command], [np.cumsum(noise, axis=0)], 10) < 0.3
    assert predictable_share([np.cumsum(noise, axis=0)], [pattern], 10) < 0.05  # a command without a period


def test_a_carried_error_loses_its_noise_and_keeps_what_follows_the_command():
    """The best linear filter of a known spectrum: what the error loses of its lines is a part of the noise in their bins."""
    time, noise = np.arange(10000) * 1e-3, np.random.default_rng(4).standard_normal((10000, 1))
    lines = sum(np.sin(2 * np.pi * f * time + f) for f in (3.0, 7.0, 31.0))[:, None]
    found, left = without_noise(lines + 0.2 * noise)
    assert np.sqrt(np.mean((found - lines) ** 2)) < 0.4 * 0.2
    assert np.sqrt(np.mean(without_noise(noise)[0] ** 2)) < 0.5
    assert np.mean(without_noise(noise + 3.0)[0]) == pytest.approx(np.mean(noise) + 3.0, abs=1e-9)
    true_left = found - without_noise(lines)[0]
    assert left.std() == pytest.approx(true_left.std(), rel=0.2)


@pytest.mark.parametrize("half_width, verdict", [(0.0, "no_gap"), (0.05, "effect")])
def test_one_clean_record_hides_nothing_that_the_model_leaves_none_of(half_width, verdict):
    """Backlash of 0.03 % of the range, beside a model that explains the clean record to its noise: that is how far it repeats."""
    time = 1e-3 * np.arange(4000)
    command = 80.0 * np.sin(2 * np.pi * 2.0 * time) * np.sin(2 * np.pi * 0.5 * time)
    moved, place = np.empty(len(command)), 0.0
    for row, u in enumerate(command):
        moved[row] = place = min(max(place, u - half_width), u + half_width)
    noise = 0.01 * np.random.default_rng(5).standard_normal((2, len(command)))

    def made(measurement: np.ndarray, source: str) -> Record:
        signals = {"command": command, "measurement": measurement}
        units = {"command": "V", "measurement": "um"}
        return Record(
            {name: Signal(time, rows[:, None], ("x",), units[name]) for name, rows in signals.items()}, source, hold="foh"
        )

    model = Model("straight", ("x",), {"command": "V", "measurement": "um"}, 1e-3, Chain((Gain(1.0),)), "foh")
    new, clean = made(moved + noise[0], "new"), made(command + noise[1], "clean")
    report, *_ = diagnosed([new], model, cache=False, baseline=[clean], without=all_but("backlash", "gain", "offset_drift"))
    assert report["verdict"] == verdict
    if half_width:
        assert report["effects"][0]["parameters"]["half_width"]["value"] == pytest.approx(half_width, rel=0.05)


def test_a_gain_of_no_signal_stands_for_no_model():
    assert Gain(0.0).filter(Sampling(1e-3, 1)).settle(np.ones(1)) == 0.0


def test_a_carried_error_comes_later_on_each_axis_by_a_part_of_a_sample():
    """A sine of 25 samples a period, against itself later; before it begins it is as at its begin."""
    phase = 2.0 * np.pi / 25.0
    rows = np.sin(phase * np.arange(200))[:, None] * [1.0, 2.0]
    late = np.array([0.4, 3.7])
    [moved] = CarriedError((rows,)).delayed(late).series
    expected = np.sin(phase * (np.arange(200)[:, None] - late)) * [1.0, 2.0]
    np.testing.assert_allclose(moved[10:], expected[10:], atol=1e-3)
    np.testing.assert_allclose(moved[0], rows[0])
    [together] = CarriedError((rows,)).delayed(np.array([0.4, 0.4])).series
    np.testing.assert_allclose(together[:, 0], moved[:, 0])


@pytest.mark.parametrize("frequency", [10.0, 40.0])
def test_noise_of_a_periodic_baseline_that_is_carried_along_is_no_sensor_noise(frequency):
    """Near the lines of the command a filter leaves it in the carried error: the residual has it beside its own."""
    time = 1e-3 * np.arange(1000)
    command = 30.0 * np.sin(2 * np.pi * frequency * time)
    machine = command + 0.01 * command**2
    for seed in range(3):
        random, signals = np.random.default_rng(seed), []
        for _ in range(2):
            measured = machine + 0.05 * random.standard_normal(len(time))
            signals.append(
                {
                    "command": Signal(time, command[:, None], ("x",), "V"),
                    "measurement": Signal(time, measured[:, None], ("x",), "um"),
                }
            )
        clean, new = (Record(each, "r") for each in signals)
        found = diagnosed([new], None, baseline=[clean], without=all_but("sensor_noise", "gain"), cache=False)[0]
        assert found["verdict"] == "no_gap"
