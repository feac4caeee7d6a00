# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""`hyst plot`: what is drawn, and how it is refused."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy.signal import cont2discrete

from hyst_control.base.config_files import config_path
from hyst_control.base.errors import InputError
from hyst_control.chain import Chain
from hyst_control.chain.linear.linear_stages import Delay, TransferFunction
from hyst_control.chain.memoryless import Gain
from hyst_control.cli import main
from hyst_control.control.model_figures import bode_of, poles_and_zeros, tuning_panels
from hyst_control.control.tuning import tune
from hyst_control.identify.assess.choice_figure import choice_panels
from hyst_control.model_file import Model, load_model, save_model, simulate
from hyst_control.records.bags.bag_reader import read_bag
from hyst_control.records.record import Record, Signal
from hyst_control.records.tables.importing import write_bag
from hyst_control.reporting.signal_figures import over_each_other, over_time, spectra, thinned

RATE = 2000.0
STRUCTURES = [
    {"axis": "x", "structure": f"{n} modes", "parameters": 4 + 2 * n, "held_out_nrmse": value, "chosen": n == 2}
    for n, value in ((1, 0.9), (2, 0.3), (3, 0.31), (4, None))
]


@pytest.fixture
def record():
    time = np.arange(20000) / RATE
    wave = np.sin(2 * np.pi * 50.0 * time)
    command = 50.0 + 40.0 * np.stack([wave, np.cos(2 * np.pi * 50.0 * time)], axis=1)
    return Record(
        {"command": Signal(time, command, ("x", "y"), "V"), "measurement": Signal(time, 0.02 * command, ("x", "y"), "mrad")}, "r"
    )


def test_a_thinned_line_keeps_every_peak():
    rng = np.random.default_rng(3)
    y = rng.standard_normal(100_000)
    y[[777, 50_001]] = 40.0, -40.0
    x, few = thinned(np.arange(len(y), dtype=float), y, 1000)
    assert len(x) <= 1000 and few.max() == 40.0 and few.min() == -40.0
    np.testing.assert_array_equal(y[x.astype(int)], few)
    assert np.all(np.diff(x) > 0)


def test_signals_of_one_unit_share_a_panel(record):
    volts, tilt = over_time(record)
    assert [line.name for line in volts.lines] == ["command.x", "command.y"]
    assert tilt.y_title == "angle [mrad]" and volts.y_title == "voltage [V]"


def test_a_spectrum_peaks_where_the_signal_does_and_holds_its_power(record):
    line = spectra(record)[1].lines[0]
    assert line.x[line.y.argmax()] == pytest.approx(50.0, abs=1.0)
    assert np.sum(line.y**2) * (line.x[1] - line.x[0]) == pytest.approx(0.5 * (0.02 * 40.0) ** 2, rel=1e-3)


def test_one_axis_over_the_other(record):
    [panel] = over_each_other(record, "measurement.x", "measurement.y")
    assert panel.x_title == "angle x [mrad]"
    np.testing.assert_allclose((panel.lines[0].x - 1.0) ** 2 + (panel.lines[0].y - 1.0) ** 2, 0.64, rtol=1e-9)
    assert len(over_each_other(record, "command", "measurement")) == 2


@pytest.mark.parametrize(
    "words", [[], ["--xy"], ["--spectrum"], ["--xy", "measurement.x", "measurement.y", "--from", "1", "--to", "2"]]
)
def test_pictures_and_pages(record, tmp_path, words):
    write_bag(tmp_path / "bag", record)
    picture, page = tmp_path / "a.png", tmp_path / "a.html"
    assert main(["plot", str(tmp_path / "bag"), *words, "--output", str(picture)]) == 0
    with Image.open(picture) as image:
        pixels = np.asarray(image.convert("RGB"))
    coloured = pixels.max(axis=2).astype(int) - pixels.min(axis=2) > 60
    assert coloured.sum() > 300, "there are curves in it"
    assert main(["plot", str(tmp_path / "bag"), *words, "--output", str(page)]) == 0
    assert "angle" in page.read_text(encoding="utf-8") and page.stat().st_size < 8e6


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e300])
def test_a_spectrum_of_what_is_no_number_is_refused_in_one_line(record, tmp_path, capsys, value):
    values = record.signals["measurement"].values.copy()
    values[100] = value
    write_bag(tmp_path / "bag", replace(record, signals={"measurement": replace(record.signals["measurement"], values=values)}))
    assert main(["plot", str(tmp_path / "bag"), "--spectrum", "--output", str(tmp_path / "a.svg")]) == 2
    told = capsys.readouterr().err
    assert told.count("\n") == 1 and "1 of 20000 samples" in told and not (tmp_path / "a.svg").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--output", "a.bmp"], "its ending says"),
        (["--xy", "command"], "takes two signals"),
        (["--xy", "command", "reference"], "has no topic reference (topics: command, measurement)"),
        (["--xy", "foo", "bar"], "has no topic foo (topics: command, measurement)"),
        (["--signals", "foo"], "has no topic foo (topics: command, measurement)"),
        (["--signals", "command", "foo"], "has no topic foo (topics: command, measurement)"),
        (["--signals", "foo", "--spectrum"], "has no topic foo (topics: command, measurement)"),
        (["--xy", "measurement.x", "command.q"], "has no axis q"),
        (["--from", "50"], "no samples from 50"),
    ],
)
def test_what_cannot_be_drawn_is_said(record, tmp_path, monkeypatch, capsys, words, said):
    monkeypatch.chdir(tmp_path)
    write_bag(tmp_path / "bag", record)
    assert main(["plot", "bag", *words]) == 2
    assert said in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["bag"]


@pytest.mark.filterwarnings("error")
def test_a_frequency_response_of_two_samples_is_refused(record, tmp_path, capsys):
    write_bag(tmp_path / "r", record)
    last = record.signal("command").time[-2]
    assert main(["plot", str(tmp_path / "r"), "--bode", "--from", f"{last:.6f}", "--output", str(tmp_path / "r.png")]) == 2
    assert capsys.readouterr().err.splitlines() == [
        f"hyst plot: {tmp_path / 'r'}: too few samples for a frequency response: choose a longer part (--from, --to)"
    ]
    assert not (tmp_path / "r.png").exists()


@pytest.fixture
def stage(tmp_path):
    """A first-order stage, as a model file and as its record."""
    model = Model("stage", ("x",), {"command": "V", "measurement": "um"}, 1 / RATE, Chain((TransferFunction([0.1], [1e-3, 1.0]),)))
    save_model(model, tmp_path / "model.yaml")
    command = 50.0 + np.random.default_rng(0).normal(0.0, 5.0, (8000, 1))
    time = np.arange(len(command)) / RATE
    signals = {"command": Signal(time, command, ("x",), "V"), "measurement": Signal(time, simulate(model, command), ("x",), "um")}
    write_bag(tmp_path / "bag", Record(signals, "bag"))
    (tmp_path / "fit.json").write_text(json.dumps({"family": "hampi", "structures": STRUCTURES}))
    (tmp_path / "other.json").write_text("{}")
    return tmp_path, model


def test_a_frequency_response_is_that_of_the_stage(stage):
    folder, model = stage
    measured, computed = bode_of(model, read_bag(folder / "bag"))[0].lines
    w = 2 * np.pi * computed.x
    # A held command and a sample later: the transform of exp(-t / 1 ms) sampled.
    pole, z = np.exp(-1.0 / (RATE * 1e-3)), np.exp(1j * w / RATE)
    np.testing.assert_allclose(computed.y, np.abs(0.1 * (1.0 - pole) / (z - pole)), rtol=1e-9)
    assert computed.x[[0, -1]] == pytest.approx(measured.x[[0, -1]], rel=1e-9), "one range of frequencies"
    near = np.interp(measured.x, computed.x, computed.y)
    assert measured.dots and np.median(np.abs(measured.y / near - 1.0)) < 0.03


@pytest.mark.parametrize(
    "words",
    [
        ["bag", "--bode"],
        ["bag", "--bode", "--model", "model.yaml"],
        ["bag", "--model", "model.yaml"],
        ["model.yaml"],
        ["model.yaml", "--poles"],
        ["model.yaml", "--tuning"],
        ["fit.json"],
    ],
)
def test_frequency_responses_and_models_are_drawn(stage, words, monkeypatch):
    monkeypatch.chdir(stage[0])
    for ending in ("png", "html"):
        assert main(["plot", *words, "--output", f"out.{ending}"]) == 0
        assert (stage[0] / f"out.{ending}").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["model.yaml", "--spectrum"], "nothing but --poles or --tuning is chosen"),
        (["bag", "--model", "model.yaml", "--xy"], "are about command and measurement"),
        (["bag", "--bode", "--signals", "command"], "are about command and measurement"),
        (["bag", "--poles"], "are of a model"),
        (["bag", "--color", "time"], "give --xy too"),
        (["bag", "bag", "--bode"], "are of one bag"),
        (["model.yaml", "bag"], "leave the other options out"),
        (["other.json"], "is no fit report"),
    ],
)
def test_options_that_do_not_go_together_are_refused(stage, words, said, monkeypatch, capsys):
    monkeypatch.chdir(stage[0])
    assert main(["plot", *words]) == 2
    assert said in capsys.readouterr().err and not list(stage[0].glob("*.png"))


def test_loops_of_several_frequencies_are_colored_by_them():
    time = np.arange(20000) / RATE
    command = 50 + 40 * np.sin(2 * np.pi * np.where(time < 5, 2.0, 30.0) * time)[:, None]
    made = Record({"command": Signal(time, command, ("x",), "V"), "measurement": Signal(time, 0.1 * command, ("x",), "um")}, "r")
    [panel] = over_each_other(made, "command", "measurement")
    assert (panel.x_title, panel.y_title, panel.shade_title) == ("voltage [V]", "position [um]", "frequency [Hz]")
    shade = panel.lines[0].shade
    assert np.median(shade[: len(shade) // 2 - 500]) == pytest.approx(2.0, rel=0.02)
    assert np.median(shade[len(shade) // 2 + 500 :]) == pytest.approx(30.0, rel=0.05)
    [one] = over_each_other(made.between(None, 4.0), "command", "measurement")
    assert one.lines[0].shade is None and not one.shade_title
    [by_time] = over_each_other(made, "command", "measurement", color="time")
    np.testing.assert_allclose(by_time.lines[0].shade, time[:: len(time) // len(by_time.lines[0].x)][: len(by_time.lines[0].x)])


@pytest.mark.parametrize("color", ["record", "time", "frequency"])
def test_records_are_drawn_over_each_other(record, tmp_path, monkeypatch, color):
    monkeypatch.chdir(tmp_path)
    for name in ("monday", "friday"):
        write_bag(tmp_path / name, record)
    for ending in ("png", "html"):
        assert main(["plot", "monday", "friday", "--xy", "--color", color, "--output", f"out.{ending}"]) == 0
        assert (tmp_path / f"out.{ending}").stat().st_size > 10_000
    [both, _] = over_each_other(record, "command", "measurement", replace(record, source="s"), color=color)
    assert [line.name for line in both.lines] == ["r", "s"]
    assert [line.name for line in over_time(record, replace(record, source="s"))[0].lines][1:3] == ["r: command.y", "s: command.x"]


@settings(deadline=None, max_examples=15)
@given(frequency=st.floats(5.0, 400.0), damping=st.floats(0.01, 0.9), lag=st.floats(2e-4, 1e-2))
def test_poles_are_those_of_the_stage(frequency, damping, lag):
    w = 2 * np.pi * frequency
    stages = (TransferFunction([1.0], [lag, 1.0]), TransferFunction([w**2], [1.0, 2 * damping * w, w**2]), Delay(3.4 / RATE))
    model = Model("m", ("x",), {"command": "V", "measurement": "um"}, 1 / RATE, Chain(stages))
    poles = poles_and_zeros(model)[0].lines[0]
    due = np.array([-1 / lag, w * (-damping + 1j * np.sqrt(1 - damping**2)), w * (-damping - 1j * np.sqrt(1 - damping**2))])
    for pole in due:
        assert np.abs(2 * np.pi * (poles.x + 1j * poles.y) - pole).min() < 1e-3 * abs(pole)


def test_zeros_of_the_sampling_are_drawn_with_their_conjugates():
    """The zero of a sampled second-order lag is real and negative in z: by scipy, at plus and minus half the rate in s."""
    fast, slow = (0.9 * np.pi * RATE) ** 2, 1e4
    num, den = [fast], [1.0, 300.0, fast]
    model = Model("m", ("x",), {"command": "V", "measurement": "um"}, 1 / RATE, Chain((TransferFunction(num, den),)))
    zeros = poles_and_zeros(model)[0].lines[1]
    sampled, *_ = cont2discrete((num, den), 1 / RATE)
    root = np.roots(sampled[0][1:])
    assert root[0] < 0.0
    np.testing.assert_allclose(2 * np.pi * zeros.x, np.repeat(np.log(-root) * RATE, 2), rtol=1e-6)
    np.testing.assert_allclose(sorted(zeros.y), [-RATE / 2, RATE / 2])
    lag = model.with_stages([TransferFunction([slow], [1.0, 30.0, slow])])
    zeros = poles_and_zeros(lag)[0].lines[1]
    assert not len(zeros.x) and zeros.name == "zeros (2 more beyond 23.9 Hz)"


def test_the_margins_of_a_tuning_are_marked():
    model = load_model(config_path("models/fsm_mhl.yaml"))
    tuning = tune(model)
    magnitude, phase, *_ = tuning_panels(tuning, model)
    crossover, margin = magnitude.lines[-2:]
    assert (
        f"worst {tuning.worst.phase_margin:.0f} deg" in crossover.name and f"worst {tuning.worst.gain_margin:.1f} dB" in margin.name
    )
    assert -20 * np.log10(margin.y[0]) == pytest.approx(tuning.nominal.gain_margin)
    loop = phase.lines[0]
    assert np.interp(margin.x[0], loop.x, loop.y) == pytest.approx(-180.0, abs=5.0)
    assert phase.lines[-1].name == "-180 deg"


def test_a_static_model_has_no_poles_to_draw(tmp_path, capsys):
    units = {"command": "V", "measurement": "um"}
    save_model(Model("still", ("x",), units, 1 / RATE, Chain((Gain(0.1), Delay(3.4 / RATE)))), tmp_path / "m.yaml")
    assert main(["plot", str(tmp_path / "m.yaml"), "--poles", "--output", str(tmp_path / "m.png")]) == 2
    assert "still: has neither poles nor zeros to draw" in capsys.readouterr().err and not (tmp_path / "m.png").exists()


def test_what_was_chosen_among_is_drawn_with_its_errors():
    [panel] = choice_panels({"family": "hampi", "structures": STRUCTURES})
    others, chosen = panel.lines
    assert list(others.x) == [6, 10] and list(others.y) == [0.9, 0.31]
    assert (chosen.name, list(chosen.x), list(chosen.y)) == ("chosen: 2 modes", [8], [0.3])
    [orders] = choice_panels({"family": "linear", "orders": [{"states": 2, "held_out": 0.1, "fitted": 0.05}]})
    assert list(orders.lines[0].y) == [10.0] and orders.x_title == "states"
    with pytest.raises(InputError, match="chose among nothing"):
        choice_panels({"family": "pi"})
