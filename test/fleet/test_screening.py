# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Screening of records before a diagnosis: the same verdict and the same gap, to rounding, as the whole diagnosis gives."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

pytest.importorskip("pyarrow")
import pyarrow.parquet
from one_process import one_process

from evaluation.benchmarks import simulated_fleet
from hyst_control.base.parallel import Workers
from hyst_control.effects import EFFECTS
from hyst_control.fleet.manifest import read_manifest
from hyst_control.fleet.record_jobs import GAPS, ONSETS, RecordJob, compute
from hyst_control.fleet.study import run_study
from hyst_control.model_file import load_model, save_model

pytestmark = pytest.mark.long_file

RIVALS = ("gain", "delay", "amplifier_lowpass", "added_mass")
WITHOUT = {"without": tuple(name for name in EFFECTS if name not in RIVALS)}
"""Whatever the diagnosis looks for, the screening must agree with it, and every effect costs time: some of those that units get."""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Three units of six runs, one with an effect, and where it begins."""
    folder = tmp_path_factory.mktemp("screened") / "fleet"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulated_fleet, "map_spawned", map)
        labels = json.loads(simulated_fleet.make_fleet(folder, 4, 3, 6, 0.34).read_text())
    [unit] = [unit for unit in labels["units"] if unit["effect"]]
    return folder, unit["name"], unit["begins"]


def row(folder, tmp_path, bag, only):
    [entry] = [entry for entry in read_manifest([str(folder / "manifest.csv")]) if entry.bag.endswith(bag)]
    return compute(RecordJob("diagnose", entry, WITHOUT if only is None else {**WITHOUT, "only": only}, str(tmp_path)))


def test_screening_changes_no_verdict(made, tmp_path):
    folder, changed, _ = made
    bag = next(f"u{index:04d}_003" for index in range(3) if f"u{index:04d}" != changed)
    whole, screened = row(folder, tmp_path, bag, None), row(folder, tmp_path, bag, GAPS)
    assert whole["verdict"] == screened["verdict"] == "no_gap"
    assert whole["measurement_unit"] == screened["measurement_unit"]
    for name in ("gap_rms", "gap_nrmse", "floor_rms"):
        assert whole[name] == pytest.approx(screened[name], rel=1e-9), name
    assert "report_file" in whole


def test_a_model_that_states_its_own_error_needs_no_search(made, tmp_path):
    """The usual file of an identification. A gap of many times that error is diagnosed as ever."""
    folder, changed, begins = made
    entries = read_manifest([str(folder / "manifest.csv")])
    stated = {"version": 1, "rms": [0.02], "correlation": 0.002}
    save_model(replace(load_model(entries[0].model), discrepancy=stated), tmp_path / "model.yaml")

    def computed(unit, run, only):
        [entry] = [entry for entry in entries if entry.bag.endswith(f"{unit}_{run:03d}")]
        entry = replace(entry, baseline=(), model=str(tmp_path / "model.yaml"))
        return compute(RecordJob("diagnose", entry, WITHOUT if only is None else {**WITHOUT, "only": only}, str(tmp_path)))

    healthy = next(f"u{index:04d}" for index in range(3) if f"u{index:04d}" != changed)
    whole, screened = computed(healthy, 3, None), computed(healthy, 3, GAPS)
    assert "report_file" in whole and "report_file" not in screened
    assert whole["verdict"] == screened["verdict"] == "no_gap" and whole["gap_rms"] == pytest.approx(screened["gap_rms"], rel=1e-9)
    assert "report_file" in computed(changed, begins, GAPS)


def test_only_the_clearest_record_of_a_unit_that_changed_is_diagnosed_and_as_ever(made, tmp_path):
    folder, changed, begins = made
    entries = read_manifest([str(folder / "manifest.csv")])
    with one_process():
        study = run_study("diagnose", entries, tmp_path / "study", {**WITHOUT, "only": ONSETS}, Workers(1))
    assert study.failed == {} and study.computed == len(entries)
    document = json.loads((tmp_path / "study" / "fleet.json").read_text())
    named = {claim["unit"]: claim["moment"] for claim in document["onsets"]}
    assert named[changed] == begins  # six runs tell little: another unit may be named beside it
    rows = pyarrow.parquet.read_table(tmp_path / "study" / "records.parquet").to_pylist()
    own = [each for each in rows if each["unit"] == changed and each["moment"] >= begins]
    [diagnosed] = [each for each in own if each["verdict"] != "not_diagnosed"]
    assert diagnosed["bag"] == max(own, key=lambda each: each["gap_rms"])["bag"]
    assert sum(each["verdict"] != "not_diagnosed" for each in rows) <= 3, "one record a unit at most"
    assert run_study("diagnose", entries, tmp_path / "study", {**WITHOUT, "only": ONSETS}, Workers(1)).computed == 0
    whole = row(folder, tmp_path, diagnosed["bag"], None)
    short = row(folder, tmp_path, diagnosed["bag"], ONSETS)
    for name in ("verdict", "reasons"):
        assert diagnosed[name] == whole[name], name
    assert [one["name"] for one in diagnosed["effects"]] == [one["name"] for one in whole["effects"]]
    for name in ("gap_rms", "gap_nrmse", "floor_rms"):
        assert diagnosed[name] == pytest.approx(whole[name], rel=1e-9), name
    assert whole["verdict"] != "no_gap"
    assert short["gap_rms"] == pytest.approx(whole["gap_rms"], rel=1e-9)
    # A fit ends where a step gains next to nothing: the last digits of the record decide which step that is.
    assert short["left_rms"] == pytest.approx(diagnosed["left_rms"], rel=1e-4)
