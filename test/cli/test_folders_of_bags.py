# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A folder of nothing but bags stands for its bags in every command that takes several, and for its one bag where one is taken."""

from __future__ import annotations

import json

import numpy as np
import pytest

from hyst_control.chain import Chain
from hyst_control.chain.memoryless import Gain
from hyst_control.cli import main
from hyst_control.fleet.manifest import read_manifest
from hyst_control.model_file import Model, save_model
from hyst_control.records.bags.bag_reader import read_bag
from hyst_control.records.record import Record, Signal
from hyst_control.records.tables.importing import write_bag

TIME = np.arange(200) * 1e-3
COMMAND = 20.0 - 20.0 * np.cos(2 * np.pi * 20.0 * TIME)[:, None]


@pytest.fixture
def runs(tmp_path):
    """A folder with the bags 1 and 2, and a model beside it."""
    for name in "12":
        signals = {
            topic: Signal(TIME, values, ("x",), unit)
            for topic, values, unit in (
                ("command", COMMAND, "V"),
                ("measurement", 0.08 * COMMAND, "um"),
                ("reference", 0.1 * COMMAND, "um"),
                ("feedback", 0.0 * COMMAND, "V"),
            )
        }
        write_bag(tmp_path / "runs" / name, Record(signals, name))
    save_model(Model("plant", ("x",), {"command": "V", "measurement": "um"}, 1e-3, Chain((Gain(0.1),))), tmp_path / "model.yaml")
    return tmp_path / "runs"


def test_plot_draws_every_bag(runs, tmp_path):
    assert main(["plot", str(runs), "--signals", "measurement", "--output", str(tmp_path / "picture.html")]) == 0
    assert main(["plot", str(runs), "--bode", "--output", str(tmp_path / "bode.html")]) == 2


def test_learn_takes_a_folder_as_its_trials(runs, tmp_path):
    out = tmp_path / "table.json"
    words = ["learn", str(tmp_path / "model.yaml"), str(runs), "--period", "0.05", "--output", str(tmp_path / "next.npy")]
    assert main([*words, "--json", str(out)]) == 0
    assert len({row["case"] for row in json.loads(out.read_text())["rows"]}) >= 2


def test_a_fleet_takes_a_folder(runs):
    assert [entry.bag for entry in read_manifest([str(runs)])] == [str(runs / "1"), str(runs / "2")]


def test_simulate_takes_a_folder_of_one_bag_and_refuses_several(runs, tmp_path, capsys):
    words = ["simulate", str(tmp_path / "model.yaml"), str(runs), "--output", str(tmp_path / "simulated")]
    assert main(words) == 2
    assert "holds 2 bags: give one of them" in capsys.readouterr().err
    assert not (tmp_path / "simulated").exists()
    (runs / "2").rename(tmp_path / "2")
    assert main(words) == 0
    simulated = read_bag(tmp_path / "simulated").signal("measurement").values
    np.testing.assert_allclose(simulated[1:], 0.1 * COMMAND[:-1], atol=1e-9)  # a command acts from the next sample on
