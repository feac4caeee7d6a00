# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A record of many axes as a fleet: every axis gives what a record of it alone gives."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pyarrow")
import pyarrow.parquet
from one_process import one_process

from hyst_control.cli import main
from hyst_control.model_file import load_model, simulate
from hyst_control.records.record import Record, Signal
from hyst_control.records.tables.importing import write_bag

MODEL = Path(__file__).resolve().parents[2] / "config" / "models" / "pea_hampi.yaml"
TS, AXES = 1e-4, tuple(f"a{index}" for index in range(20))


def signals(axes, gains):
    command = 25.0 - 25.0 * np.cos(2 * np.pi * 20.0 * TS * np.arange(1500))[:, None] * np.ones(len(gains))
    one = simulate(load_model(MODEL), command[:, :1], TS)
    time = TS * np.arange(1500)
    return {"command": Signal(time, command, axes, "V"), "measurement": Signal(time, one * gains, axes, "um")}


def test_every_axis_is_a_unit(tmp_path):
    gains = 1.0 + 0.01 * np.arange(20)
    write_bag(tmp_path / "run", Record(signals(AXES, gains), "run"))
    lines = ["bag,unit,time,model", f"run,mirror,1,{MODEL}", f"gone,mirror,2,{MODEL}"]
    (tmp_path / "manifest.csv").write_text("\n".join(lines) + "\n")
    words = [
        "fleet",
        "validate",
        str(tmp_path / "manifest.csv"),
        "--split-axes",
        "--output",
        str(tmp_path / "study"),
        "--workers",
        "1",
    ]
    with one_process():
        assert main([*words, "--json", str(tmp_path / "out.json")]) == 0
    out = json.loads((tmp_path / "out.json").read_text())
    assert (out["computed"], len(out["failed"])) == (20, 1), "a bag that cannot be read costs itself"
    rows = {row["unit"]: row for row in pyarrow.parquet.read_table(tmp_path / "study" / "records.parquet").to_pylist()}
    for index in (0, 7, 19):
        stated = 100.0 * (gains[index] - 1.0) / gains[index]
        assert rows[f"mirror/a{index}"]["errors"][0]["nme"] == pytest.approx(stated, abs=1e-3)
    assert main([*words, "--json", str(tmp_path / "out.json")]) == 0
    assert json.loads((tmp_path / "out.json").read_text())["kept"] == 20


def test_clean_records_of_other_axes_are_refused(tmp_path, capsys):
    write_bag(tmp_path / "new", Record(signals(AXES[:2], np.ones(2)), "new"))
    write_bag(tmp_path / "clean", Record(signals(AXES[1:3], np.ones(2)), "clean"))
    words = ["fleet", "diagnose", str(tmp_path / "new"), "--baseline", str(tmp_path / "clean"), "--split-axes"]
    assert main([*words, "--output", str(tmp_path / "study")]) == 2
    assert "has other axes" in capsys.readouterr().err
