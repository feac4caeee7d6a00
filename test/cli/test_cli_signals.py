# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""`hyst excite` and `hyst simulate`: what they write, and that bad input costs one line and leaves nothing."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from hyst_control.cli import main
from hyst_control.records.bags.bag_reader import read_bag
from hyst_control.records.excitation.excitation import KINDS, build

DELAYED_GAIN = """
format: hyst_control/model
version: 1
name: delayed
axes: [x]
units: {command: V, measurement: um}
sample_time: 1.0e-3
hold: zoh
valid: {command: [0.0, 100.0], frequency: [0.0, 100.0]}
chain:
  - {stage: delay, tau: 2.0e-3}
  - {stage: gain, gain: 0.25}
noise: {sigma: 0.01}
"""


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "model.yaml"
    path.write_text(DELAYED_GAIN)
    return path


SINE = ["sine", "frequency=10", "amplitude=20", "offset=25", "duration=0.2"]
TIME = np.arange(200) / 1000
COMMAND = 25 + 20 * np.sin(2 * np.pi * 10 * TIME)


def test_table_array_and_bag_hold_the_same_signal(tmp_path):
    for name in ("a.csv", "a.npy", "a.bag"):
        assert main(["excite", *SINE, "--rate", "1000", "--output", str(tmp_path / name)]) == 0
    table = np.loadtxt(tmp_path / "a.csv", delimiter=",", skiprows=1)
    assert (tmp_path / "a.csv").read_text().startswith("t[s],x[V]\n")
    bag = read_bag(tmp_path / "a.bag").signals["command"]
    np.testing.assert_allclose(table, np.column_stack([TIME, COMMAND]), atol=1e-12)
    np.testing.assert_array_equal(np.load(tmp_path / "a.npy")[:, 0], table[:, 1])
    np.testing.assert_array_equal(bag.values[:, 0], table[:, 1])
    np.testing.assert_array_equal(bag.time, table[:, 0])
    assert bag.unit == "V"


def test_description_gives_the_signal_back(tmp_path):
    file = tmp_path / "scan.yaml"
    words = ["raster", "width=1", "height=0.5", "lines=4", "line_time=0.05"]
    assert main(["excite", *words, "--axes", "2", "--unit", "mrad", "--rate", "1000", "--output", str(file)]) == 0
    assert (
        main(["excite", str(file), "--axes", "2", "--unit", "mrad", "--rate", "1000", "--output", str(tmp_path / "scan.bag")]) == 0
    )
    signal = read_bag(tmp_path / "scan.bag").signals["reference"]
    np.testing.assert_array_equal(signal.values, build(yaml.safe_load(file.read_text()), 1e-3, 2))
    assert signal.axes == ("x", "y") and np.ptp(signal.values, axis=0) == pytest.approx([1.0, 0.5], rel=0.05)


def test_list_names_every_kind(capsys):
    assert main(["excite", "--list"]) == 0
    first_words = {line.split()[0] for line in capsys.readouterr().out.splitlines()}
    assert set(KINDS) <= first_words


def test_simulated_bag_is_the_delayed_command_times_the_gain(tmp_path, model):
    """measurement[k] is taken before command[k] acts, so two samples of delay show as three rows."""
    assert main(["simulate", str(model), "--excitation", *SINE, "--output", str(tmp_path / "a.bag")]) == 0
    signals = read_bag(tmp_path / "a.bag").signals
    np.testing.assert_allclose(signals["command"].values[:, 0], COMMAND, atol=1e-12)
    delayed = np.concatenate([np.full(3, COMMAND[0]), COMMAND[:-3]])
    np.testing.assert_allclose(signals["measurement"].values[:, 0], 0.25 * delayed, atol=1e-12)


def test_bag_and_excitation_give_the_same_and_the_seed_adds_the_stated_noise(tmp_path, model):
    outputs = {}
    for name, source in (
        ("excited", ["--excitation", *SINE]),
        ("replayed", [str(tmp_path / "excited")]),
        ("noisy", [str(tmp_path / "excited"), "--seed", "1"]),
    ):
        assert main(["simulate", str(model), *source, "--output", str(tmp_path / name)]) == 0
        outputs[name] = read_bag(tmp_path / name).signals["measurement"].values
    np.testing.assert_array_equal(outputs["replayed"], outputs["excited"])
    assert np.std(outputs["noisy"] - outputs["excited"]) == pytest.approx(0.01, rel=0.2)


@pytest.mark.parametrize(
    "words, said",
    [
        (["excite", "sin", "--output", "OUT"], "'sin' is not known"),
        (["excite", "sine", "--output", "OUT"], "frequency: is missing"),
        (["excite", "sine", "frequency", "--output", "OUT"], "parameter=value"),
        (["excite", "sine", "frequency=[1", "--output", "OUT"], "frequency="),
        (["excite", *SINE, "upper=30", "--output", "OUT.csv"], "lower the amplitude"),
        (["excite", *SINE, "--rate", "nan", "--output", "OUT"], "rate"),
        (["excite", *SINE, "--axes", "0", "--output", "OUT"], "axes"),
        (["excite", *SINE, "--unit", "inch", "--output", "OUT"], "unit"),
        (["excite", "nowhere.yaml", "--output", "OUT"], "nowhere.yaml"),
        (["excite", *SINE], "--output"),
        (["excite", "sine", "freq=10"], "freq: no such parameter"),
        (["excite", *SINE, "--output", "nowhere/OUT.csv"], "nowhere"),
        (["simulate", "nowhere.yaml", "--excitation", *SINE, "--output", "OUT"], "nowhere.yaml"),
        (["simulate", "MODEL", "--output", "OUT"], "either a bag or --excitation"),
        (["simulate", "MODEL", "nowhere.bag", "--output", "OUT"], "nowhere.bag"),
        (["simulate", "MODEL", "--excitation", *SINE, "--rate", "-1", "--output", "OUT"], "rate"),
        (["simulate", "MODEL", "--excitation", *SINE, "--seed", "-1", "--output", "OUT"], "--seed: must be >= 0, got -1"),
        (["learn", "MODEL", "--reference", *SINE, "--plant", "pea", "--seed", "-1"], "--seed: must be >= 0, got -1"),
        (["diagnose", "record", "--model", "MODEL", "--seed", "-1"], "--seed: must be >= 0, got -1"),
        (["blind-test", "--seed", "-1"], "--seed: must be >= 0, got -1"),
        (["cases", "make", "--seed", "-1", "--count", "1", "--output", "OUT"], "--seed: must be >= 0, got -1"),
        (["tune", "MODEL", "--loop-delay", "-3"], "--loop-delay: must be >= 0 ticks, got -3"),
        (["excite", "sine", "frequency=abc", "amplitude=1", "--output", "OUT"], "frequency: must be a number, got 'abc'"),
        (["excite", *SINE, "--rate", "20", "--output", "OUT"], "frequency: must be below half the sample rate, 10 Hz"),
        (["excite", *SINE, "--output", "OUT.xyz"], "OUT.xyz: its ending says what is written"),
    ],
)
def test_bad_input_is_refused_in_one_line_and_leaves_nothing(tmp_path, monkeypatch, capsys, model, words, said):
    monkeypatch.chdir(tmp_path)
    assert main([str(model) if word == "MODEL" else word for word in words]) == 2
    told = capsys.readouterr()
    assert said in told.err and len(told.err.strip().splitlines()) == 1 and not told.out
    assert [path.name for path in tmp_path.iterdir()] == ["model.yaml"]


def test_an_existing_file_is_not_overwritten(tmp_path, capsys):
    file = tmp_path / "kept.csv"
    file.write_text("mine")
    assert main(["excite", *SINE, "--output", str(file)]) == 2
    assert file.read_text() == "mine" and "exists already" in capsys.readouterr().err
