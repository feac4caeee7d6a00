# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Manifests and studies of many records, with real bags; the results are read by pyarrow alone."""

from __future__ import annotations

import json
import shutil
from functools import partial
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pyarrow")
import pyarrow as pa
import pyarrow.parquet
from one_process import one_process

from hyst_control.base.errors import InputError
from hyst_control.cli import main
from hyst_control.diagnose import workflow
from hyst_control.effects import EFFECTS
from hyst_control.fleet.manifest import moment, read_manifest
from hyst_control.fleet.overview import check_limits, overview
from hyst_control.fleet.study import _changed
from hyst_control.model_file import load_model, simulate
from hyst_control.records.record import Record, Signal
from hyst_control.records.tables.importing import write_bag

pytestmark = pytest.mark.long_file

MODEL = Path(__file__).resolve().parents[2] / "config" / "models" / "pea_hampi.yaml"
TS = 1e-4


def record(gain, seed):
    """A short record of the model with its gain changed, and a little noise."""
    model = load_model(MODEL)
    command = 25.0 - 25.0 * np.cos(2 * np.pi * 20.0 * TS * np.arange(2000))[:, None]
    found = gain * simulate(model, command, TS) + 1e-3 * np.random.default_rng(seed).standard_normal((2000, 1))
    time = TS * np.arange(2000)
    return Record({"command": Signal(time, command, ("x",), "V"), "measurement": Signal(time, found, ("x",), "um")}, "made")


@pytest.fixture
def fleet(tmp_path):
    """Three units of two runs, the manifest beside them."""
    lines = ["bag,unit,time,model,temperature"]
    shutil.copy(MODEL, tmp_path / "model.yaml")
    for unit in range(3):
        for run in range(2):
            write_bag(tmp_path / "bags" / f"u{unit}_{run}", record(1.0 + 0.05 * unit, 10 * unit + run))
            lines.append(f"bags/u{unit}_{run},u{unit},{run},model.yaml,{20 + run}.5")
    (tmp_path / "manifest.csv").write_text("\n".join(lines) + "\n")
    return tmp_path


@pytest.fixture
def in_this_process():
    """Without workers, which would import the package anew: `test_a_study_is_taken_up_where_something_changed` has some."""
    with one_process():
        yield


def rows(study):
    return pyarrow.parquet.read_table(study / "records.parquet").to_pylist()


def test_a_study_is_taken_up_where_something_changed(fleet, capsys):
    words = ["fleet", "validate", str(fleet / "manifest.csv"), "--output", str(fleet / "study"), "--json", str(fleet / "out.json")]

    def run(*options):
        assert main([*words, *options]) == 0
        return json.loads((fleet / "out.json").read_text())

    first = run("--workers", "2")
    assert (first["records"], first["computed"], first["kept"], first["failed"]) == (6, 6, 0, [])
    before = rows(fleet / "study")
    assert [(row["unit"], row["time"], row["temperature"]) for row in before[:2]] == [("u0", "0", 20.5), ("u0", "1", 21.5)]
    for row in before:
        stated = 100 * 0.05 * int(row["unit"][1])
        assert row["errors"][0]["nme"] == pytest.approx(stated / (1 + stated / 100), abs=0.6)
    with one_process():
        assert run()["computed"] == 0
    assert rows(fleet / "study") == before
    shutil.rmtree(fleet / "bags" / "u1_0")
    write_bag(fleet / "bags" / "u1_0", record(1.2, 5))
    with one_process():
        second = run()
    assert (second["computed"], second["kept"]) == (1, 5)
    changed = [row["bag"] for row, old in zip(rows(fleet / "study"), before, strict=True) if row["errors"] != old["errors"]]
    assert changed == [str(fleet / "bags" / "u1_0")]
    with open(fleet / "model.yaml", "a") as file:
        file.write("# another model\n")
    with one_process():
        assert run()["computed"] == 6


def test_a_bag_that_cannot_be_read_costs_itself(fleet):
    (file,) = (fleet / "bags" / "u2_1").glob("*.mcap")
    file.write_bytes(b"nothing")
    shutil.rmtree(fleet / "bags" / "u0_0")
    words = ["fleet", "validate", str(fleet / "manifest.csv"), "--output", str(fleet / "study"), "--json", str(fleet / "out.json")]
    with one_process():
        assert main(words) == 0
    out = json.loads((fleet / "out.json").read_text())
    assert {Path(each["bag"]).name for each in out["failed"]} == {"u2_1", "u0_0"}
    found = {Path(row["bag"]).name: row["status"] for row in rows(fleet / "study")}
    assert sorted(name for name, status in found.items() if status == "failed") == ["u0_0", "u2_1"] and len(found) == 6
    write_bag(fleet / "bags" / "u0_0", record(1.0, 0))
    with one_process():
        assert main(words) == 0
    again = json.loads((fleet / "out.json").read_text())
    assert again["computed"] == 2 and len(again["failed"]) == 1, "what failed is tried again"


@pytest.mark.usefixtures("in_this_process")
def test_a_study_in_which_every_record_failed_says_so(tmp_path, capsys):
    (tmp_path / "empty.mcap").write_bytes(b"")
    words = ["fleet", "identify", str(tmp_path / "empty.mcap"), str(tmp_path / "missing"), "--workers", "1"]
    assert main([*words, "--output", str(tmp_path / "study")]) == 2
    said = capsys.readouterr().out
    assert "2 failed" in said and "missing: " in said
    assert [row["status"] for row in rows(tmp_path / "study")] == ["failed", "failed"]
    assert (tmp_path / "study" / "fleet.html").exists()


@pytest.mark.parametrize("kind", ["empty", "noise", "other columns", "other types"])
def test_results_that_are_none_are_refused_in_one_line(kind, tmp_path, capsys):
    study = tmp_path / "study"
    study.mkdir()
    (study / "summary.json").write_text('{"kind": "identify"}')
    file = study / "records.parquet"
    if kind == "other columns":
        pyarrow.parquet.write_table(pa.table({"a": [1]}), file)
    elif kind == "other types":
        names = ("unit", "time", "moment", "bag", "status", "reason", "mark", "model_file")
        pyarrow.parquet.write_table(pa.table({name: [3] for name in names}), file)
    else:
        file.write_bytes(b"" if kind == "empty" else b"PAR1" + np.random.default_rng(0).bytes(200) + b"PAR1")
    before = {path: path.read_bytes() for path in study.iterdir()}
    population = ["fleet", "population", str(study), "--output", str(tmp_path / "model.yaml")]
    for words in (population, ["fleet", "identify", str(tmp_path / "bag"), "--output", str(study)]):
        assert main(words) == 2
        told = capsys.readouterr().err
        assert told.count("\n") == 1 and "records.parquet: " in told
    assert {path: path.read_bytes() for path in study.iterdir()} == before and not (tmp_path / "model.yaml").exists()


def test_models_and_diagnoses(fleet, monkeypatch):
    bag = str(fleet / "bags" / "u2_0")
    common = [bag, "--names", r"(?P<unit>u\d)_(?P<time>\d)", "--workers", "1"]
    words = [*common, "--model", str(MODEL), "--output", str(fleet / "gaps")]
    without = [name for name in EFFECTS if name not in ("gain", "offset")]  # which only cost time
    monkeypatch.setattr(workflow, "diagnose_bags", partial(workflow.diagnose_bags, without=without))
    with one_process():
        assert main(["fleet", "identify", *common, "--family", "hapi", "--output", str(fleet / "models")]) == 0
        assert main(["fleet", "diagnose", *words]) == 0
    [row] = rows(fleet / "models")
    assert row["family"] == "hapi" and row["parameters"]
    assert load_model(row["model_file"]).axes == ("x",)
    [row] = rows(fleet / "gaps")
    wanted = np.std(record(1.1, 20).signal("measurement").values - record(1.0, 20).signal("measurement").values)
    assert row["verdict"] and row["measurement_unit"] == "um" and row["gap_rms"] > wanted
    assert main(["fleet", "validate", *words]) == 2, "a study of another kind"


def test_a_cluster_of_this_machine_computes_what_a_process_does(fleet):
    pytest.importorskip("distributed", reason="Dask is an optional package")
    words = ["fleet", "validate", str(fleet / "bags" / "u2_0"), "--model", str(MODEL), "--workers", "1"]
    assert main([*words, "--cluster", "local", "--output", str(fleet / "cluster")]) == 0
    with one_process():
        assert main([*words, "--output", str(fleet / "process")]) == 0
    [on_cluster], [here] = rows(fleet / "cluster"), rows(fleet / "process")
    assert on_cluster["errors"] == here["errors"] and here["errors"]


def test_manifests(fleet):
    entries = read_manifest([str(fleet / "manifest.csv")])
    assert [entry.unit for entry in entries] == ["u0", "u0", "u1", "u1", "u2", "u2"]
    table = pa.table({"bag": [entry.bag for entry in entries], "unit": [entry.unit for entry in entries], "run": [1] * 6})
    pyarrow.parquet.write_table(table, fleet / "m.parquet")
    assert [(entry.unit, entry.columns["run"]) for entry in read_manifest([str(fleet / "m.parquet")])][:1] == [("u0", "1")]
    named = read_manifest([str(fleet / "bags" / "*")], r"(?P<unit>u\d)_(?P<time>\d)")
    assert [(entry.unit, entry.moment) for entry in named[:2]] == [("u0", 0.0), ("u0", 1.0)]
    assert moment("2026-03-01T12:00:00+00:00") == 1772366400.0


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("unit,time\nu,1\n", "row 1: bag: is missing"),
        ("bag,time\nb,noon\n", "row 1: time: must be a number or a date"),
        ("bag\nb\nb\n", "is listed twice"),
        ("bag\n", "lists no records"),
        ("bag,unit\nb,u,3\n", "more cells"),
        ("bag,time\nb,nan\n", "row 1: time: must be a number or a date"),
        ("bag,unit,time\na,u,0\nb,u,0.0\n", r"b: time: .*a of the same unit has 0.0 too: give every record of a unit its own"),
        ("bag,time\na,1\nb,2026-03-02\n", "time: a number at .*a, a date at .*b: give all records numbers"),
        ("bag,time\na,1\nb,\n", "time: a number at .*a, none at .*b: "),
    ],
)
def test_a_manifest_that_is_none(tmp_path, text, said):
    (tmp_path / "m.csv").write_text(text)
    with pytest.raises(InputError, match=said):
        read_manifest([str(tmp_path / "m.csv")])


def test_without_times_records_are_counted_by_unit_in_the_order_of_the_manifest(tmp_path):
    (tmp_path / "m.csv").write_text("bag,unit\nz,u\ny,u\nx,v\na,u\n")
    entries = read_manifest([str(tmp_path / "m.csv")])
    assert [(Path(entry.bag).name, entry.unit, entry.moment) for entry in entries] == [
        ("z", "u", 0.0),
        ("y", "u", 1.0),
        ("a", "u", 2.0),
        ("x", "v", 0.0),
    ]
    named = read_manifest(["b/u0_a", "b/u0_b", "b/u1_a"], r"(?P<unit>u\d)")
    assert [(entry.unit, entry.moment) for entry in named] == [("u0", 0.0), ("u0", 1.0), ("u1", 0.0)]


def test_a_record_without_a_time_is_not_since_a_change():
    row = {"bag": "b", "unit": "u", "status": "done", "moment": float("nan"), "gap_rms": 1.0, "baseline": []}
    assert _changed(overview("diagnose", []), [row]) == set()


def test_an_existing_path_is_no_pattern(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "r [1]" / "bag").mkdir(parents=True)
    assert [entry.bag for entry in read_manifest(["r [1]/bag"])] == ["r [1]/bag"]


def test_results_of_records_that_a_manifest_no_longer_lists_are_kept(fleet, capsys):
    """They count in no evaluation, and are not computed again; what the manifest says of records is what it says now."""
    path, study = fleet / "manifest.csv", fleet / "study"
    whole = path.read_text()

    def run():
        assert main(["fleet", "validate", str(path), "--output", str(study), "--json", str(fleet / "out.json")]) == 0
        return json.loads((fleet / "out.json").read_text())["computed"], rows(study)

    with one_process():
        computed, before = run()
        assert computed == len(before) == 6
        path.write_text("".join(whole.splitlines(keepends=True)[:3]).replace("20.5", "9.5"))
        shutil.rmtree(fleet / "bags" / "u0_1")
        write_bag(fleet / "bags" / "u0_1", record(1.0, 1))
        capsys.readouterr()
        computed, few = run()
        assert computed == 1 and [row["bag"] for row in few] == [row["bag"] for row in before[:2]]
        assert [row["temperature"] for row in few] == [9.5, 21.5]
        assert f"kept in {study / 'others.parquet'}: 4 results" in capsys.readouterr().out
        assert json.loads((study / "fleet.json").read_text())["units"] == 1
        path.write_text(whole)
        computed, again = run()
    assert computed == 0 and [row["temperature"] for row in again] == [20.5, 21.5] * 3
    assert [row["errors"] for row in again[2:]] == [row["errors"] for row in before[2:]]
    assert not (study / "others.parquet").exists()


@pytest.mark.parametrize(
    ("kind", "quantity"),
    [
        ("diagnose", "gap_rms"),
        ("diagnose", "creep.gamma"),
        ("validate", "nrmse x"),
        ("identify", "0.prandtl_ishlinskii.weights[3]"),
    ],
)
def test_quantities_that_a_study_may_find_have_limits(kind, quantity):
    check_limits(kind, {quantity: 1.0})


@pytest.mark.usefixtures("in_this_process")
def test_columns_of_the_manifest_have_any_name(fleet):
    """Those that a study has itself stand beside its own."""
    path = fleet / "manifest.csv"
    names = ("status", "reason", "records", "moment", "errors", "seconds", "")
    first, *lines = path.read_text().splitlines()
    more = [f"{line},{','.join(f'{name}{number}' for name in names)}" for number, line in enumerate(lines)]
    path.write_text("\n".join([f"{first},{','.join(names)}", *more]))
    for _ in range(2):  # the second time all is there
        assert main(["fleet", "validate", str(path), "--output", str(fleet / "study"), "--workers", "1"]) == 0
        found = rows(fleet / "study")
        assert [row["status"] for row in found] == ["done"] * 6 and found[1]["reason"] == "" and found[1]["moment"] == 1.0
        given = [f"manifest.{name}" if name in ("status", "reason", "moment", "errors", "seconds") else name for name in names]
        assert [found[4][name] for name in given] == [f"{name}4" if name else 4.0 for name in names]


@pytest.mark.usefixtures("in_this_process")
def test_numbers_of_the_manifest_are_numbers_in_the_results(fleet):
    """Names and versions stay texts, and so does a column of numbers in which a name turns up later."""
    path, study = fleet / "manifest.csv", fleet / "study"
    first, *lines = path.read_text().splitlines()
    more = [f"{line},007,{('1.1', '1.10')[k % 2]},{('40', '')[k % 2]}" for k, line in enumerate(lines)]
    for load in ("2", "new"):
        rest = [f"{line},2" for line in more[:-1]] + [f"{more[-1]},{load}"]
        path.write_text("\n".join([f"{first},serial,firmware,humidity,load", *rest]))
        shutil.rmtree(fleet / "bags" / "u2_1")  # another record, computed again
        write_bag(fleet / "bags" / "u2_1", record(1.2, 30))
        assert main(["fleet", "validate", str(path), "--output", str(study), "--workers", "1", "--quiet"]) == 0
        found = rows(study)
        assert [row["temperature"] for row in found] == [20.5, 21.5] * 3 and [row["humidity"] for row in found] == [40.0, None] * 3
        assert [found[1][name] for name in ("serial", "firmware")] == ["007", "1.10"]
        assert [found[k]["load"] for k in (0, -1)] == ([2.0, 2.0] if load == "2" else ["2", "new"])


@pytest.mark.usefixtures("in_this_process")
def test_a_validation_of_one_axis_is_named_by_the_axis_of_the_model(fleet):
    """So that the records of a unit are runs of one quantity, whatever their bags are called."""
    assert main(["fleet", "validate", str(fleet / "manifest.csv"), "--output", str(fleet / "study"), "--workers", "1"]) == 0
    found = rows(fleet / "study")
    assert {error["axis"] for row in found for error in row["errors"]} == {"x"}
    seen = overview("validate", found)
    assert list(seen.series) == ["nrmse x"] and np.isfinite(seen.series["nrmse x"]).all()


@pytest.mark.parametrize(
    "words, said",
    [
        ("score study", "takes one study and its labels"),
        ("score study other --labels labels.json", "takes one study and its labels"),
        ("identify fleet.csv --labels labels.json", "--labels: goes with score"),
        ("identify fleet.csv", "--output: is missing"),
        ("population study other --output out", "a population is made of one study"),
        ("identify fleet.csv --of unit --output out", "--of: goes with population"),
        ("diagnose fleet.csv --family hapi --output out", "--family: goes with identify"),
        ("validate fleet.csv --pages --output out", "--pages: goes with diagnose"),
        ("validate fleet.csv --only gaps --output out", "--only: goes with diagnose"),
        ("validate fleet.csv --limit gap_rms=none --output out", "--limit gap_rms=none: must be QUANTITY=VALUE"),
        ("validate fleet.csv --limit gap_rms=1 --output out", "--limit gap_rms: is no quantity that validate finds"),
        ("identify fleet.csv --limit foo=1 --output out", "--limit foo: is no quantity that identify finds"),
        (
            "diagnose fleet.csv --limit foo=1 --output out",
            "--limit foo: is no quantity that diagnose finds: give gap_rms, or EFFECT.SIZE",
        ),
        ("identify fleet.csv --family foo --output out", "--family: must be one of "),
        ("diagnose nope.csv --output out", "nope.csv: does not exist: give the path of a manifest\n"),
        ("diagnose nope.parquet --output out", "nope.parquet: does not exist: give the path of a manifest\n"),
    ],
)
def test_options_that_do_not_go_together_are_refused_in_one_line(words, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "fleet.csv").write_text("unit,bag\nA,a\n")
    assert main(["fleet", *words.split()]) == 2
    seen = capsys.readouterr().err
    assert said in seen and len(seen.strip().splitlines()) == 1 and not (tmp_path / "out").exists()
