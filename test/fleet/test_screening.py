"""Screening of records before a diagnosis: the same verdict and the same gap, to the bit, as the whole diagnosis gives."""

from __future__ import annotations

import json

import numpy as np
import pytest

from hyst_control.blind_test import simulated_fleet
from hyst_control.fleet.manifest import read_manifest
from hyst_control.fleet.record_jobs import GAPS, ONSETS, RecordJob, compute
from hyst_control.fleet.study import run_study
from hyst_control.parallel import Workers

pytest.importorskip("pyarrow")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Three units of six nights, one with an effect, and where it begins."""
    folder = tmp_path_factory.mktemp("screened") / "fleet"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulated_fleet, "map_spawned", map)
        labels = json.loads(simulated_fleet.make_fleet(folder, 4, 3, 6, 0.34).read_text())
    [unit] = [unit for unit in labels["units"] if unit["effect"]]
    return folder, unit["name"], unit["begins"]


def row(folder, tmp_path, bag, only):
    [entry] = [entry for entry in read_manifest([str(folder / "manifest.csv")]) if entry.bag.endswith(bag)]
    return compute(RecordJob("diagnose", entry, {} if only is None else {"only": only}, str(tmp_path)))


def test_a_record_without_a_gap_is_told_from_the_coefficients_alone(made, tmp_path):
    folder, changed, _ = made
    bag = next(f"u{index:04d}_003" for index in range(3) if f"u{index:04d}" != changed)
    whole, screened = row(folder, tmp_path, bag, None), row(folder, tmp_path, bag, GAPS)
    assert whole["verdict"] == screened["verdict"] == "no_gap"
    for name in ("gap_rms", "gap_nrmse", "floor_rms", "measurement_unit"):
        assert whole[name] == screened[name], name
    assert "report_file" in whole and "report_file" not in screened


def test_a_record_with_a_gap_is_diagnosed_as_ever(made, tmp_path):
    folder, changed, begins = made
    bag = f"{changed}_{begins:03d}"
    short, screened, whole = (row(folder, tmp_path, bag, only) for only in (ONSETS, GAPS, None))
    assert short["verdict"] == "not_diagnosed" and short["gap_rms"] == whole["gap_rms"]
    for name in set(whole) - {"seconds", "left_rms"}:
        assert screened[name] == whole[name], name
    assert whole["verdict"] != "no_gap" and screened["left_rms"] == short["left_rms"]


def test_only_the_clearest_record_of_a_unit_that_changed_is_diagnosed(made, tmp_path):
    folder, changed, begins = made
    entries = read_manifest([str(folder / "manifest.csv")])
    study = run_study("diagnose", entries, tmp_path / "study", {"only": ONSETS}, Workers(1))
    assert study.failed == {} and study.computed == len(entries)
    document = json.loads((tmp_path / "study" / "fleet.json").read_text())
    named = {claim["unit"]: claim["moment"] for claim in document["onsets"]}
    assert named == {changed: float(begins)}
    assert len(list((tmp_path / "study" / "reports").glob(f"{changed}_*.json"))) == 1
    again = run_study("diagnose", entries, tmp_path / "study", {"only": ONSETS}, Workers(1))
    assert again.computed == 0 and np.isfinite(again.seconds)
