"""`hyst plot`: what is drawn, and how it is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from hyst_control.chain import Chain
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.cli import main
from hyst_control.control.model_figures import bode_of
from hyst_control.model_file import Model, save_model, simulate
from hyst_control.records.bags.bag_reader import read_bag
from hyst_control.records.record import Record, Signal
from hyst_control.records.tables.importing import write_bag
from hyst_control.reporting.signal_figures import over_each_other, over_time, spectra, thinned

RATE = 2000.0


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
    assert tilt.y_title == "[mrad]"


def test_a_spectrum_peaks_where_the_signal_does_and_holds_its_power(record):
    line = spectra(record)[1].lines[0]
    assert line.x[line.y.argmax()] == pytest.approx(50.0, abs=1.0)
    assert np.sum(line.y**2) * (line.x[1] - line.x[0]) == pytest.approx(0.5 * (0.02 * 40.0) ** 2, rel=1e-3)


def test_one_axis_over_the_other(record):
    [panel] = over_each_other(record, "measurement.x", "measurement.y")
    assert panel.x_title == "measurement.x [mrad]"
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
    assert "measurement" in page.read_text(encoding="utf-8") and page.stat().st_size < 8e6


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
        (["--xy", "command", "reference"], "has no topic reference"),
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


@pytest.fixture
def stage(tmp_path):
    """A first-order stage, as a model file and as its record."""
    model = Model("stage", ("x",), {"command": "V", "measurement": "um"}, 1 / RATE, Chain((TransferFunction([0.1], [1e-3, 1.0]),)))
    save_model(model, tmp_path / "model.yaml")
    command = 50.0 + np.random.default_rng(0).normal(0.0, 5.0, (8000, 1))
    time = np.arange(len(command)) / RATE
    signals = {"command": Signal(time, command, ("x",), "V"), "measurement": Signal(time, simulate(model, command), ("x",), "um")}
    write_bag(tmp_path / "bag", Record(signals, "bag"))
    return tmp_path, model


def test_a_frequency_response_is_that_of_the_stage(stage):
    folder, model = stage
    measured, computed = bode_of(model, read_bag(folder / "bag"))[0].lines
    w = 2 * np.pi * computed.x
    # A held command and a sample later: the transform of exp(-t / 1 ms) sampled.
    pole, z = np.exp(-1.0 / (RATE * 1e-3)), np.exp(1j * w / RATE)
    np.testing.assert_allclose(computed.y, np.abs(0.1 * (1.0 - pole) / (z - pole)), rtol=1e-9)
    near = np.interp(measured.x, computed.x, computed.y)
    assert measured.dots and np.median(np.abs(measured.y / near - 1.0)) < 0.03


@pytest.mark.parametrize(
    "words", [["bag", "--bode"], ["bag", "--bode", "--model", "model.yaml"], ["bag", "--model", "model.yaml"], ["model.yaml"]]
)
def test_frequency_responses_and_models_are_drawn(stage, words, monkeypatch):
    monkeypatch.chdir(stage[0])
    for ending in ("png", "html"):
        assert main(["plot", *words, "--output", f"out.{ending}"]) == 0
        assert (stage[0] / f"out.{ending}").stat().st_size > 10_000


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["model.yaml", "--spectrum"], "of a model the frequency response is drawn"),
        (["bag", "--model", "model.yaml", "--xy"], "are about command and measurement"),
        (["bag", "--bode", "--signals", "command"], "are about command and measurement"),
    ],
)
def test_options_that_do_not_go_together_are_refused(stage, words, said, monkeypatch, capsys):
    monkeypatch.chdir(stage[0])
    assert main(["plot", *words]) == 2
    assert said in capsys.readouterr().err and not list(stage[0].glob("*.png"))
