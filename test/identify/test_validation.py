# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Errors by frequency and amplitude, from motions that are given."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import hyst_control as hc
from hyst_control.cli import main
from hyst_control.identify.validation import MAX_MOTIONS, Motion, by_motion


def test_few_motions_are_told_one_by_one():
    assert by_motion([Motion(1.0, 20.0, 10.0, 0.1, 200)]) == [("1 Hz, 20 V", pytest.approx(0.01), 200)]


def test_motions_of_one_name_are_one_row():
    found = by_motion([Motion(1.0, 20.0, 10.0, 0.1, 200), Motion(2.0, 20.0, 10.0, 0.1, 50), Motion(1.0, 20.0, 10.0, 0.3, 200)])
    assert found == [("1 Hz, 20 V (2 motions)", pytest.approx(0.05**0.5 / 10), 400), ("2 Hz, 20 V", pytest.approx(0.01), 50)]


def test_many_motions_are_told_by_octaves_and_none_is_lost():
    random = np.random.default_rng(1)
    motions = [
        Motion(frequency, amplitude, 2.0 * amplitude, 0.02 * amplitude, 100)
        for frequency, amplitude in zip(random.uniform(5.0, 40.0, 300), random.uniform(1.0, 60.0, 300), strict=True)
    ]
    found = by_motion(motions)
    assert len(found) <= MAX_MOTIONS and sum(rows for *_, rows in found) == 300 * 100
    assert all(share == pytest.approx(0.01) for _, share, _ in found)
    assert found[0][0].startswith("4-8 Hz, ")
    fast = by_motion([replace(one, frequency=50.0 * one.frequency) for one in motions])
    assert fast[-1][0].startswith("1024-2048 Hz, ")


@pytest.mark.parametrize("words", [["validate"], ["compare", "model.yaml"], ["plot", "record", "--model"]])
def test_a_record_whose_axes_have_other_names_is_no_fault_of_it(words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    stage = hc.load_model("pea_hampi")
    stage.save("model.yaml")
    command = 25 - 20 * np.cos(2 * np.pi * 50 * np.arange(5000) * stage.sample_time)
    simulated = stage.simulate(command, seed=1)
    hc.from_arrays(command, simulated.measurement, 1 / stage.sample_time, axes=["tip"], hold=stage.hold).save("record")
    rest = ["record", "--strict"] if words[0] != "plot" else ["--output", "drawn.png"]
    assert main([*words, "model.yaml", *rest]) == 0
    assert "record: its axes tip are taken for the axes x of" in capsys.readouterr().out


def test_rows_that_are_left_out_are_told(tmp_path, monkeypatch, capsys):
    """Both extremes are met late, and the measurement lacks its last rows."""
    monkeypatch.chdir(tmp_path)
    stage = hc.load_model("pea_hampi")
    time = np.arange(20_000) * stage.sample_time
    command = 25 + np.sin(2 * np.pi * 50 * time + 1) * (12 + 10 * np.exp(-(((time - 0.1) / 0.05) ** 2)))
    whole = stage.simulate(command, seed=1)
    late = int(np.argmax(command >= command.max() - 0.01 * np.ptp(command)))
    stage.save("model.yaml")
    whole.save("whole")
    signals = {**whole.signals, "command": replace(whole.signal("command"), **rows_of(whole.signal("command"), 19_900))}
    replace(whole, signals=signals).save("record")
    assert main(["validate", "model.yaml", "record", "--start", "unknown", "--json", "scores.json"]) == 0
    [told] = json.loads(Path("scores.json").read_text())["notes"]
    assert told in capsys.readouterr().out
    missed, before = (int(number) for number in re.findall(r": (\d+) (?:of|before)", told))
    assert before >= late and missed == before + 100
    assert f"{before} before the hysteresis memory is known; 100 without a command" in told
    assert main(["validate", "model.yaml", "whole", "--start", "settled"]) == 0
    assert "not compared" not in capsys.readouterr().out


def rows_of(signal, count):
    """Its first rows, as `replace` takes them."""
    return {"time": signal.time[:count], "values": signal.values[:count]}
