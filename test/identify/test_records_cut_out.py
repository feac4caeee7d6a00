# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Records cut out of a longer run, whose dynamics move already when they begin: plants by scipy, against true poles, gain and noise."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from hyst_control.chain import Chain
from hyst_control.chain.linear.linear_stages import StateSpace, TransferFunction
from hyst_control.chain.memoryless import Offset
from hyst_control.diagnose.workflow import diagnosed
from hyst_control.identify import LITTLE, identify
from hyst_control.identify.assess.fit_report import MOVING, residual, with_state
from hyst_control.identify.assess.free_motion import ending_dynamics, free_motion, without_free_motion
from hyst_control.identify.data.fit_windows import closed_loop
from hyst_control.identify.data.hold_choice import hold_errors
from hyst_control.identify.data.initial_memory import begins_at_rest, with_beginning
from hyst_control.identify.modal.coupled_linear import spectra_of
from hyst_control.identify.validation import validate_record
from hyst_control.model_file import Model
from hyst_control.records.record import Record, sampled_record
from hyst_control.records.validity.checks import examined
from hyst_control.records.validity.findings import Trial

PERIOD = 1.0 / 5000
SLOW = [2.0 * 25.0**2 * 4 * np.pi**2], [1.0, 2 * 0.02 * 25.0 * 2 * np.pi, (25.0 * 2 * np.pi) ** 2]
"""A mode of 25 Hz, of which a record of 0.3 s has eight periods."""
SLOW_LAG = [0.5], [0.06, 1.0]


def stairs(count: int, hold: int, seed: int) -> np.ndarray:
    return np.repeat(np.random.default_rng(seed).uniform(20, 80, count // hold + 1), hold)[:count]


def cut_out(plant, command: np.ndarray, kept: int, noise: float = 6e-4, period: float = PERIOD, hold: str = "zoh"):
    """The last `kept` rows of the plant's answer to a command, and the rms of the noise in it."""
    b, a, _ = signal.cont2discrete(plant, period, hold)
    start = signal.lfilter_zi(b.ravel(), a) * command[0]
    answer = signal.lfilter(b.ravel(), a, command, zi=start)[0][-kept:]
    sigma = noise * np.ptp(answer)
    noisy = answer + sigma * np.random.default_rng(7).normal(size=kept)
    return sampled_record("cut", command[-kept:, None], noisy[:, None], period, ("x",), "um", "zoh", "auto"), sigma


def with_error(data: Record, added: np.ndarray) -> Record:
    """The record with an error (N,) of the model in its measurement."""
    return data.with_values(measurement=data.measurement + added[:, None])


def test_a_start_that_the_record_states_is_kept():
    """A mode that rings from before: estimated unless the record's start is stated, part of the error if it is stated as at rest."""
    data, sigma = cut_out(SLOW, stairs(3000, 300, 3), 1500)
    model = identify([data], "linear").model
    stated = replace(data, start="settled")
    assert with_state(model, data).start != data.start and with_state(model, stated).start == "settled"
    assert np.std(residual(model, data)) < 1.1 * sigma and np.std(residual(model, stated)) > 10.0 * sigma


def test_a_mode_that_rings_from_before_is_found_and_explained_to_the_noise():
    data, sigma = cut_out(SLOW, stairs(3000, 300, 3), 1500)
    fit = identify([data], "linear")
    row = fit.report["records"][0]
    assert row["rmse"] < 1.1 * sigma and fit.report["beginnings"][0]["assumed"] == MOVING
    found = {each["name"]: each["value"] for each in fit.report["parameters"]}
    assert found["frequency[0]"] == pytest.approx(25.0, rel=2e-3) and found["damping[0]"] == pytest.approx(0.02, rel=0.05)
    assert found["static_gain"] == pytest.approx(2.0, rel=5e-3)
    table = validate_record({"m": fit.model}, data)
    assert table.value("cut", "m", "rmse") == pytest.approx(row["rmse"], rel=1e-9)


def test_a_linear_model_counts_all_rows_where_a_hysteresis_would_forget():
    """A command that meets its extremes after 40 % of the rows: play operators count from there, a linear model has no such memory."""
    time = np.arange(6000) * PERIOD
    command = 20 + np.sin(2 * np.pi * 25 * time + 1) * (3 + 6 * np.exp(-(((time - 0.5) / 0.1) ** 2)))
    data, _ = cut_out(SLOW_LAG, command, 6000)
    rows = {}
    for family, options in (("linear", {"order": 1}), ("pi", {"operators": 3})):
        report = identify([data], family, **options).report
        rows[family] = report["records"][0]["samples"]
        assert (report["beginnings"][0]["first_row"] == 0) == (family == "linear")
    assert rows["linear"] == len(data) and rows["pi"] < 0.7 * len(data)


def test_a_slow_lag_cut_out_is_no_useless_model():
    data, sigma = cut_out(SLOW_LAG, stairs(3000, 25, 5), 1500)
    fit = identify([data], "linear")
    assert fit.report["records"][0]["rmse"] < 1.1 * sigma and not any("explains" in note for note in fit.report["notes"])


def test_modes_near_the_nyquist_frequency_are_found():
    """Two modes at an eighth and at more than a quarter of the sample rate, whose measured samples no straight lines join."""
    one, other = (([w * w], [1.0, 2 * z * w, w * w]) for w, z in ((2 * np.pi * 25.0, 0.012), (2 * np.pi * 58.0, 0.045)))
    plant = np.polyadd(np.polymul(one[0], other[1]), 0.3 * np.polymul(other[0], one[1])), np.polymul(one[1], other[1])
    random, rows = np.random.default_rng(2), np.arange(4000)
    command = sum(np.cos(2 * np.pi * k * rows / 4000 + random.uniform(0, 6)) for k in range(7, 1600, 31))
    data, sigma = cut_out(plant, np.tile(command, 2), 4000, 1.2e-3, 1 / 200)
    fit = identify([data], "linear")
    assert fit.report["states"] == 4 and fit.report["records"][0]["rmse"] < 1.1 * sigma


def test_a_record_that_happens_to_end_where_it_began_was_not_preceded_by_itself():
    """With a drift of the sensor, which hides in a comparison of errors what the motion from before makes."""
    random = np.random.default_rng(8)
    b, a, _ = signal.cont2discrete(SLOW, PERIOD, "zoh")
    command = signal.lfilter([0.02], [1.0, -0.98], random.normal(size=9000))
    measurement = signal.lfilter(b.ravel(), a, command)
    sigma = 1e-3 * np.ptp(measurement)
    measurement += sigma * random.normal(size=9000) + 0.15 * np.ptp(measurement) * np.linspace(0, 1, 9000)
    near = [np.abs(each[3000:, None] - each[None, :3000]) < 0.015 * np.ptp(each[3000:6000]) for each in (command, measurement)]
    last, first = np.argwhere(np.tril(near[0] & near[1]))[0]
    rows = slice(first, 3000 + last + 1)
    data = sampled_record("cut", command[rows, None], measurement[rows, None], PERIOD, ("x",), "um", "zoh", "auto")
    assert closed_loop(data)
    fit = identify([data], "linear")
    assert fit.report["records"][0]["nrmse_own_zero"] < 110.0 * sigma / np.ptp(measurement[rows])


def model_of(*stages) -> Model:
    return Model("m", ("x",), {"command": "V", "measurement": "um"}, PERIOD, Chain(tuple(stages)), "zoh")


def test_free_motion_against_a_closed_form():
    rate = 40.0
    dynamics = ending_dynamics(model_of(TransferFunction((rate,), (1.0, rate)), Offset(3.0)), PERIOD, "zoh")
    assert dynamics is not None
    motion = free_motion(dynamics, 300)[0, :, 0]
    np.testing.assert_allclose(motion / motion[0], np.exp(-rate * PERIOD * np.arange(300)), rtol=1e-10)
    assert ending_dynamics(model_of(Offset(3.0)), PERIOD, "zoh") is None


def test_coupled_axes_share_their_states():
    """Two outputs of one state each way: what both show is one motion, and a zero of each axis stays."""
    system = StateSpace([[-30.0, 0.0], [0.0, -70.0]], np.eye(2), [[1.0, 0.5], [-0.5, 1.0]], np.zeros((2, 2)))
    model = Model("m", ("x", "y"), {"command": "V", "measurement": "um"}, PERIOD, Chain((system,)), "zoh")
    time = PERIOD * np.arange(2000)
    states = np.stack([4.0 * np.exp(-30.0 * time), -2.0 * np.exp(-70.0 * time)], axis=1)
    error = states @ np.array([[1.0, 0.5], [-0.5, 1.0]]).T + [1.0, 2.0]
    data = sampled_record("r", np.zeros((2000, 2)), error, PERIOD, ("x", "y"), "um", "zoh", "settled")
    without_free_motion(model, data, error)
    np.testing.assert_allclose(error, np.broadcast_to([1.0, 2.0], error.shape), atol=1e-8)


def test_a_record_at_rest_stays_so():
    model = model_of(TransferFunction(*(tuple(part) for part in SLOW)))
    command = np.concatenate([np.full(200, 20.0), stairs(1300, 300, 3)])
    data, _ = cut_out(SLOW, command, 1500)
    assert with_state(model, replace(data, start="settled")).start == "settled"
    assert np.std(residual(model, replace(data, start="settled"))) < 2e-3 * np.ptp(data.measurement)


def test_a_slow_motion_that_leaves_more_of_the_rows_that_follow_is_none():
    """An error of the model in the first rows, such as of a loop: a lag of 0.3 s and a drift that cancel nearly all of it there."""
    model = model_of(TransferFunction((1.0,), (0.3, 1.0)))
    command = 50.0 + 40.0 * np.sin(2 * np.pi * 3.0 * PERIOD * np.arange(12000))
    data, sigma = cut_out(([1.0], [0.3, 1.0]), command, 12000, noise=1e-4)
    place = np.clip(np.arange(12000) / 4096, 0.0, 1.0)
    bent = 0.5 * place * (1.0 - place) * (1.0 - 2.0 * place)
    wrong = with_error(data, bent)
    still = np.sqrt(np.mean((bent + sigma * np.random.default_rng(7).normal(size=12000)) ** 2))
    assert np.sqrt(np.mean(residual(model, wrong) ** 2)) < 1.05 * still


@pytest.mark.parametrize("gain", [1.0, 1.08])
def test_a_record_cut_out_is_no_gap_and_a_gain_in_it_is(gain):
    data, sigma = cut_out(SLOW, stairs(3000, 300, 3), 1500)
    model = replace(model_of(TransferFunction(*(tuple(part) for part in SLOW))), noise={"sigma": sigma})
    today = Record({**data.signals, "measurement": replace(data.signals["measurement"], values=gain * data.measurement)}, "today")
    report, *_ = diagnosed([today], model, cache=False)
    if gain == 1.0:
        assert report["verdict"] == "no_gap"
    else:
        assert report["verdict"] == "effect" and report["effects"][0]["name"] == "gain"
        assert report["effects"][0]["parameters"]["gain"]["value"] == pytest.approx(0.08, abs=0.01)


@pytest.mark.parametrize("hold", ["zoh", "foh"])
def test_the_hold_of_fast_dynamics_is_told(hold):
    command = np.random.default_rng(4).normal(size=6000)
    data, _ = cut_out(([0.7], [5e-5, 1.0]), command, 4000, 1e-3, 5e-5, hold)
    assert hold_errors(data).own_row == (hold == "foh")


def test_slow_dynamics_behind_a_smooth_command_are_a_sound_record():
    """A triangle wave of any phase explains a lag of many samples: no reason to call the sensor unplugged."""
    slow = [0.2 * 34.0**2 * 0.4], np.polymul([1.0, 11.0, 34.0**2], [1.0, 0.4])
    rows = np.arange(4000)
    command = 50.0 + 30.0 * signal.sawtooth(2 * np.pi * 7 * rows / 4000, 0.5)
    data, sigma = cut_out(slow, command, 4000, 5e-3, 1 / 200, "foh")
    fit = identify([data], "linear")
    assert fit.report["records"][0]["rmse"] < 1.2 * sigma
    assert not examined([Trial("r", data.command, data.measurement, data.sample_time, data.axes)])[0]


def loops_of(command: np.ndarray) -> np.ndarray:
    """Five play operators, from rest at 0 V."""
    thresholds, states = np.array([0.0, 3.0, 8.0, 15.0, 25.0]), np.zeros(5)
    loops = np.empty(len(command))
    for k, u in enumerate(command):
        states = np.clip(states, u - thresholds, u + thresholds)
        loops[k] = states @ [0.06, 0.02, 0.015, 0.01, 0.01]
    return loops


@pytest.mark.parametrize(("frequency", "damping"), [(30.0, 0.04), (15.0, 0.05)])
def test_play_operators_with_a_mode_that_rings_from_before(frequency, damping):
    """A fit that begins at rest leaves more than ten times the noise of these records."""
    rate, rows, w = 1000.0, np.arange(8000), 2 * np.pi * frequency
    command = 50.0 + 45.0 * signal.chirp(rows / rate, 0.375, 8.0, 2.0 * frequency)
    data, sigma = cut_out(([w * w], [1.0, 2 * damping * w, w * w]), loops_of(command), 4000, 1e-3, 1 / rate)
    data = data.with_values(command=command[-4000:, None])
    row = identify([data], "hapi").report["records"][0]
    assert row["nrmse_own_zero"] < 130.0 * sigma / np.ptp(data.measurement)


def test_play_operators_without_a_motion_from_before_ask_no_linear_model(monkeypatch):
    """Its search took four times as long as the fit itself, for mechanics that are at rest when the record begins at 50 V."""
    rate, w, rows = 1000.0, 2 * np.pi * 60.0, np.arange(6000)
    waves = 20.0 * np.sin(2 * np.pi * 1.5 * rows / rate) + 15.0 * np.sin(2 * np.pi * 7.3 * rows / rate)
    command = 50.0 + waves * np.sin(np.pi * rows / 6000)
    data, _ = cut_out(([w * w], [1.0, 0.2 * w, w * w]), loops_of(command), 6000, 1e-3, 1 / rate)
    data = data.with_values(command=command[:, None])
    assert not begins_at_rest(with_beginning(data))
    monkeypatch.setattr(sys.modules["hyst_control.identify"], "identify", lambda *_, **__: pytest.fail("a linear model is fitted"))
    fit = identify([data], "hapi")
    assert fit.report["records"][0]["nrmse_own_zero"] < LITTLE and ending_dynamics(fit.model, 1 / rate, "zoh") is not None


@pytest.mark.parametrize("seed", [5, 6, 7])
def test_beside_a_baseline_record_cut_out_as_well_nothing_is_named(seed):
    """The same machine on two days, each record cut out of a longer run: the motion from before is in both."""
    whole, sigma = cut_out(SLOW_LAG, stairs(6000, 25, seed), 3000)
    model = replace(model_of(TransferFunction((0.5 / 0.06,), (1.0, 1.0 / 0.06))), noise={"sigma": sigma})
    today, before = (replace(whole.rows(begin, begin + 1500), start="auto", source=str(begin)) for begin in (1500, 0))
    report, *_ = diagnosed([today], model, baseline=[before], cache=False)
    assert report["verdict"] == "no_gap"


def test_no_mode_of_coupled_axes_rings_between_the_lines_of_a_command():
    """Axes driven one after the other in a band, whose commands jump to rest: simulated beside the true answer, all is the noise."""
    random, half, step = np.random.default_rng(1), 2000, 1e-4
    command = np.zeros((2 * half, 2))
    for axis in range(2):
        lines = random.choice(np.arange(1, 300), 40, replace=False)
        waves = [np.cos(2 * np.pi * line * np.arange(half) / half + random.uniform(0, 6.28)) for line in lines]
        command[axis * half : (axis + 1) * half, axis] = np.sum(waves, axis=0)
    fast = 5059.0
    plants = ([fast**2], [1, 0.394 * fast, fast**2]), ([1957.0], [1, 1957.0])
    answers = []
    for plant, gains in zip(plants, ([6.6, 0.2], [-0.5, 6.6]), strict=True):
        b, a, _ = signal.cont2discrete(plant, step, "foh")
        driven = command @ gains
        answers.append(signal.lfilter(b.ravel(), a, driven, zi=signal.lfilter_zi(b.ravel(), a) * driven[0])[0])
    answer = np.stack(answers, axis=1)
    sigma = 2e-3 * np.ptp(answer)
    noisy = answer + sigma * random.normal(size=answer.shape)
    data = sampled_record("two", command, noisy, step, ("x", "y"), "um", "foh", "auto")
    assert len(spectra_of(data).angle) == half - 1, "lines that the commands hardly reach count too"
    fit = identify([data], "linear")
    for axis, row in enumerate(fit.report["records"]):
        assert row["nrmse_own_zero"] < 110.0 * sigma / np.ptp(noisy[:, axis])
