# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A small simulated fleet: the same for the same seed, effects from their run on only, and scores against hand-made studies."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest

from evaluation.benchmarks.simulated_fleet import CLEAN_RUNS, make_fleet
from hyst_control.base.errors import InputError
from hyst_control.cli import main
from hyst_control.fleet.manifest import read_manifest
from hyst_control.records.bags.bag_reader import read_bag

UNITS, RUNS = 4, 6


@pytest.fixture(scope="module")
def fleet(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fleet") / "made"
    assert main(["cases", "make", "--fleet", str(UNITS), str(RUNS), "--seed", "5", "--output", str(folder)]) == 0
    return folder


def measured(folder, unit, run):
    return read_bag(folder / "bags" / f"{unit}_{run:03d}").signal("measurement").values[:, 0]


def test_an_effect_begins_in_its_run_and_is_as_large_as_labeled(fleet, tmp_path):
    labels = json.loads((fleet / "labels.json").read_text())
    more = tmp_path / "more"
    make_fleet(more, 9, 3, RUNS, changed=1.0)
    for unit in json.loads((more / "labels.json").read_text())["units"]:
        assert CLEAN_RUNS < unit["begins"] < RUNS and unit["gap_rms"] > 2.5 * labels["scatter_rms"]
        runs = np.array([measured(more, unit["name"], run) for run in range(RUNS)])
        steps = np.sqrt(np.mean((runs - runs[:CLEAN_RUNS].mean(axis=0)) ** 2, axis=1))
        before, after = steps[: unit["begins"]], steps[unit["begins"] :]
        assert before.max() < 0.6 * unit["gap_rms"] and abs(after / unit["gap_rms"] - 1.0).max() < 0.5


def test_the_manifest_names_model_clean_records_driver_and_temperature(fleet):
    entries = read_manifest([str(fleet / "manifest.csv")])
    assert len(entries) == UNITS * RUNS
    assert all(set(entry.columns) == {"driver", "temperature"} for entry in entries)
    assert [len(entry.baseline) for entry in entries[:RUNS]] == [0] * CLEAN_RUNS + [CLEAN_RUNS] * (RUNS - CLEAN_RUNS)
    with open(fleet / "manifest.csv", newline="") as file:
        assert "effect" not in next(csv.reader(file)), "labels are sealed"


def test_the_same_seed_gives_the_same_fleet(fleet, tmp_path):
    again = tmp_path / "again"
    make_fleet(again, 5, UNITS, RUNS)
    assert (again / "labels.json").read_bytes() == (fleet / "labels.json").read_bytes()
    assert np.array_equal(measured(again, "u0003", 5), measured(fleet, "u0003", 5))
    with pytest.raises(InputError, match="holds files already"):
        make_fleet(again, 5, UNITS, RUNS)
    with pytest.raises(InputError, match="at least 1 unit and 5 runs"):
        make_fleet(tmp_path / "none", 5, 3, 2)


def test_too_few_runs_are_refused_before_anything_is_written(tmp_path, capsys):
    folder = tmp_path / "made"
    words = ["cases", "make", "--seed", "7", "--output", str(folder), "--fleet"]
    assert main([*words, "3", "4"]) == 2
    assert "--fleet: must be at least 1 unit and 5 runs, got 3 and 4" in capsys.readouterr().err and not folder.exists()
    assert main([*words, "1", "5"]) == 0


def test_a_fleet_without_effects_has_nothing_to_score(tmp_path, capsys):
    (tmp_path / "labels.json").write_text(json.dumps({"units": [{"name": "u0", "effect": {}}], "runs": 5, "driver": None}))
    (tmp_path / "fleet.json").write_text(json.dumps({"onsets": [], "trends": [], "common_causes": []}))
    assert main(["fleet", "score", str(tmp_path), "--labels", str(tmp_path / "labels.json")]) == 0
    assert "nothing to score" in capsys.readouterr().out


@pytest.mark.parametrize(
    "labels",
    [
        {"units": [{}], "driver": None},
        {"units": [{"name": "u0", "effect": {"name": "gain"}}], "driver": None},
        {"units": 3, "driver": None},
        {"units": [], "driver": {}},
    ],
)
def test_labels_that_are_none_are_refused_in_one_line(labels, tmp_path, capsys):
    (tmp_path / "labels.json").write_text(json.dumps({"runs": 5, **labels}))
    (tmp_path / "fleet.json").write_text(json.dumps({"onsets": [], "trends": [], "common_causes": []}))
    assert main(["fleet", "score", str(tmp_path), "--labels", str(tmp_path / "labels.json")]) == 2
    said = capsys.readouterr().err
    assert "labels.json: holds no labels of a fleet (" in said and len(said.strip().splitlines()) == 1


def test_scores(tmp_path, capsys):
    units = [
        {"name": f"u{index}", "effect": {"name": "gain"} if index < 4 else {}, "begins": 10 if index < 4 else 20}
        for index in range(9)
    ]
    labels = {"units": units, "runs": 20, "driver": {"driver": "d1", "effect": "amplifier_lowpass", "begins": 10}}
    (tmp_path / "labels.json").write_text(json.dumps(labels))
    onsets = [{"unit": unit, "moment": moment, "probability": p} for unit, moment, p in
              [("u0", 10.0, 1.0), ("u0", 3.0, 0.9), ("u1", 11.0, 1.0), ("u2", 13.0, 1.0), ("u7", 4.0, 1.0)]]  # fmt: skip
    study = {"onsets": onsets, "trends": [], "common_causes": [{"column": "driver", "value": "d1"}]}
    (tmp_path / "study").mkdir()
    (tmp_path / "study" / "fleet.json").write_text(json.dumps(study))
    words = [
        "fleet",
        "score",
        str(tmp_path / "study"),
        "--labels",
        str(tmp_path / "labels.json"),
        "--json",
        str(tmp_path / "out.json"),
    ]
    assert main(words) == 0
    rows = {row["quantity"]: row["value"] for row in json.loads((tmp_path / "out.json").read_text())["rows"]}
    assert rows == pytest.approx(
        {"precision": 3 / 4, "recall": 3 / 4, "run within 1": 2 / 3, "driver named": 1.0, "other drivers named": 0.0}
    )
    (tmp_path / "study" / "fleet.json").write_text("[]")
    assert main(words) == 2 and "fleet.json" in capsys.readouterr().err
