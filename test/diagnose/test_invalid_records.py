# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Diagnosis of records that are no measurement of their command: verdict unknown, the reason named, nothing fitted."""

import json

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

import hyst_control as hc
from hyst_control.base.config_files import config_path
from hyst_control.cli import main
from hyst_control.diagnose import workflow
from hyst_control.diagnose.report.invalid_records import invalid_report
from hyst_control.identify import workflow as identification
from hyst_control.model_file import load_model, model_from_document, save_model, simulate
from hyst_control.records.excitation.excitation import build
from hyst_control.records.record import Record, Signal
from hyst_control.records.tables.importing import write_bag
from hyst_control.records.validity.findings import NAMES

MODEL = config_path("models/pea_hampi.yaml")


@pytest.fixture(scope="module")
def sound():
    model = load_model(MODEL)
    command = build({"signal": "diagnostic", "lowest": 0.0, "highest": 50.0, "duration": 1.0}, model.sample_time)
    noise = 0.003 * np.random.default_rng(0).normal(size=command.shape)
    return model, command, simulate(model, command) + noise


def record(model, command, measurement, name="made"):
    time = np.arange(len(command)) * model.sample_time
    return Record({"command": Signal(time, command, ("x",), "V"), "measurement": Signal(time, measurement, ("x",), "um")}, name)


SPOILT = {
    "noise_alone": lambda u, y: (u, np.random.default_rng(1).normal(size=y.shape)),
    "dead_sensor": lambda u, y: (u, np.full_like(y, 2.5)),
    "shuffled_command": lambda u, y: (np.random.default_rng(1).permutation(u), y),
    "reversed_command": lambda u, y: (u[::-1], y),
    "sign_turned": lambda u, y: (u, -y),
    "scaled_measurement": lambda u, y: (u, 1e3 * y),
    "swapped_signals": lambda u, y: (y, u),
}


@pytest.mark.parametrize("name", SPOILT)
def test_the_report_names_the_reason_and_fits_nothing(name, sound, tmp_path, monkeypatch, capsys):
    model, command, measurement = sound
    monkeypatch.setattr(workflow, "diagnosed", None)
    write_bag(tmp_path / "bag", record(model, *map(np.ascontiguousarray, SPOILT[name](command, measurement))))
    out, page = tmp_path / "gap.json", tmp_path / "gap.html"
    assert main(["diagnose", str(tmp_path / "bag"), "--model", str(MODEL), "--json", str(out), "--report", str(page)]) == 2
    document = json.loads(out.read_text())
    assert document["verdict"] == "unknown" and document["reasons"] == ["invalid_record", name]
    assert document["effects"] == [] and document["invalid_records"][0]["name"] == name
    assert "is no measurement of its command" in capsys.readouterr().err and name.replace("_", " ") in page.read_text()


def test_the_report_has_the_gap_of_the_record(sound):
    """The gap is that of the model's simulation, whatever the record is."""
    model, command, measurement = sound
    (document, _), _ = invalid_report([record(model, command, -measurement)], model)
    assert document["gap"]["rms"] == pytest.approx(np.sqrt(np.mean((-measurement - simulate(model, command)) ** 2)), rel=1e-9)
    assert document["gap"]["nrmse"] == pytest.approx(100.0 * document["gap"]["rms"] / np.ptp(measurement), rel=1e-9)


@pytest.mark.parametrize("ppm", [300.0, -2000.0])
def test_two_clocks_are_the_reason_and_not_an_effect(sound, ppm):
    """The remedy names the difference: with it the record is sound."""
    model, command, _ = sound
    exact = simulate(model, command)[:, 0]  # so smooth between its ticks that any interpolation is the machine's motion
    ticks = np.arange(len(command)) * (1.0 + 1e-6 * ppm)
    ticks = ticks[ticks < len(command) - 1]
    measured = make_interp_spline(np.arange(len(exact)), exact, 5)(ticks) + 1e-3 * np.random.default_rng(3).normal(size=len(ticks))
    given = record(model, command[: len(ticks)], measured[:, None])
    (document, words), _ = invalid_report([given], model)
    assert document["reasons"] == ["invalid_record", "clock_difference"]
    told = float(words.split("hyst edit --clock ")[1].rstrip(")"))
    assert told == pytest.approx(ppm, abs=15.0)
    one = hc.from_arrays(given.command, given.measurement, 1.0 / model.sample_time, axes=model.axes, hold="zoh").reclock(told)
    assert invalid_report([one], model)[0] is None


@pytest.mark.parametrize(
    "change",
    [
        lambda u, y: 1.05 * y,
        lambda u, y: np.vstack([y[:1], y[:-1]]),
        lambda u, y: y * np.linspace(1.0, 1.1, len(y))[:, None],
        lambda u, y: y + np.linspace(0.0, 0.1, len(y))[:, None] * np.ptp(y),
        lambda u, y: y + 0.03 * np.ptp(y) * np.random.default_rng(5).normal(size=y.shape),
    ],
    ids=["gain", "delay", "gain that drifts", "zero that drifts", "noise"],
)
def test_no_other_change_is_a_difference_of_clocks(sound, change):
    model, command, measurement = sound
    found, notes = invalid_report([record(model, command, change(command, measurement))], model)
    assert found is None and not any("clocks" in note for note in notes)


def test_a_sound_record_is_diagnosed(sound):
    model, command, measurement = sound
    assert invalid_report([record(model, command, measurement)], model)[0] is None


def test_records_that_cannot_be_read_are_left_to_the_diagnosis(sound):
    model, command, measurement = sound
    assert invalid_report([record(model, command, np.full_like(measurement, np.nan))], model)[0] is None
    assert invalid_report([record(model, command, measurement)], load_model(config_path("models/fsm_mhl.yaml")))[0] is None


@pytest.mark.parametrize(
    "name, spoil",
    [
        *SPOILT.items(),
        ("reversed_time", lambda u, y: (u[::-1], y[::-1])),
        ("unplugged_sensor", lambda u, y: (u, np.cumsum(np.random.default_rng(2).normal(size=y.shape), axis=0))),
    ],
)
def test_measured_records_are_refused_by_both_commands(name, spoil, measured_data, tmp_path, monkeypatch, capsys):
    """The piezo stack, with a plain gain for its model; an identification sees the sound record beside the spoilt one."""
    rows = np.loadtxt(measured_data / "pea_p885" / "Test_Vi_Do_Di.dat")[7400:]
    u, y = rows[:, :1], rows[:, 4:5]
    chain = [{"stage": "gain", "gain": 12.0}]
    head = {"format": "hyst_control/model", "version": 1, "name": "gain", "axes": ["x"], "sample_time": 0.005}
    model = model_from_document({**head, "units": {"command": "V", "measurement": "um"}, "chain": chain})
    save_model(model, tmp_path / "gain.yaml")
    for label, (command, measurement) in (("sound", (u, y)), ("spoilt", spoil(u, y))):
        write_bag(tmp_path / label, record(model, np.ascontiguousarray(command), np.ascontiguousarray(measurement)))
    monkeypatch.setattr(workflow, "diagnosed", None)
    monkeypatch.setattr(identification, "identify", None)
    words = ["diagnose", str(tmp_path / "spoilt"), "--model", str(tmp_path / "gain.yaml"), "--json", str(tmp_path / "gap.json")]
    assert main(words) == 2
    document = json.loads((tmp_path / "gap.json").read_text())
    assert document["verdict"] == "unknown" and document["reasons"] == ["invalid_record", name]
    assert invalid_report([record(model, u, y)], model)[0] is None
    capsys.readouterr()
    words = [
        "identify",
        str(tmp_path / "sound"),
        str(tmp_path / "spoilt"),
        "--model",
        "linear",
        "--output",
        str(tmp_path / "m.yaml"),
    ]
    assert main(words) == 2 and not (tmp_path / "m.yaml").exists()
    line = capsys.readouterr().err
    # Without a model the inverse of play operators is as good: that one is refused beside the sound record.
    assert line.count("\n") == 1 and (NAMES[name][0] in line or name == "swapped_signals")
