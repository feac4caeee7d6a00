# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A fit is held against a constant and a gain; one that explains less says so, and writes no model unless it is told to."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from hyst_control.base.errors import InputError
from hyst_control.chain import Chain, Sampling
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.cli import main
from hyst_control.identify import estimators, workflow
from hyst_control.identify.assess.attainable import Poor, poorly_explained
from hyst_control.identify.assess.explained_share import DISAGREE, EXPLAINS, INVALID, NOTHING, POORLY, explained_shares, useless
from hyst_control.identify.assess.fit_report import record_rows
from hyst_control.identify.data.fit import Fit
from hyst_control.identify.families.estimator import every_option
from hyst_control.identify.workflow import identify_bags
from hyst_control.model_file import Model, load_model, model_from_document
from hyst_control.records.record import Record, Signal, sampled_record
from hyst_control.records.tables.importing import write_bag

STEP = 1e-3
TIME = np.arange(9000) * STEP
FREQUENCIES = np.arange(1, 120) / 3.0
PHASES = np.random.default_rng(5).uniform(0, 2 * np.pi, len(FREQUENCIES))
DRIVE = 10.0 + 0.5 * np.sin(2 * np.pi * np.outer(TIME, FREQUENCIES) + PHASES).sum(axis=1)


HELD = np.append(DRIVE[:1], DRIVE[:-1])
"""What a plant without dynamics answers to a DAC's command: that of the row before."""


def gain_model(gain: float) -> Model:
    return model_from_document(
        {
            "format": "hyst_control/model",
            "version": 1,
            "name": "made",
            "axes": ["x"],
            "sample_time": STEP,
            "units": {"command": "V", "measurement": "um"},
            "chain": [{"stage": "gain", "gain": gain}],
        }
    )


def drifting(change):
    """The answer of a gain, (N, 1), by a sensor that drifts over the record."""
    return (0.4 * HELD + np.linspace(-0.5, 0.5, len(HELD)) * change)[:, None]


def bag(path, measurement):
    signals = {
        "command": Signal(TIME, DRIVE[:, None], ("x",), "V"),
        "measurement": Signal(TIME, measurement[:, None], ("x",), "um"),
    }
    write_bag(path, Record(signals, "made"))
    return str(path)


@pytest.mark.parametrize("drift", [0.0, 30.0])
def test_shares_are_those_of_a_regression_with_a_session_of_its_own_for_every_record(drift):
    """A parabola of the model's error a record counts for neither side, and the rest is ordinary least squares."""
    random = np.random.default_rng(0)
    records, way, parabola = [], np.linspace(-1.0, 1.0, len(DRIVE)), np.vander(np.linspace(-1.0, 1.0, len(DRIVE)), 3)
    for k in range(2):
        measured = 0.4 * DRIVE + drift * (k + way) + random.normal(size=len(DRIVE))
        records.append(sampled_record(str(k), DRIVE[:, None], measured[:, None], STEP, ("x",), "um", start="settled"))
    errors = [data.measurement - 0.3 * data.command for data in records]
    [row] = explained_shares(records, errors)
    sessions = np.kron(np.eye(2), parabola)

    def left(target, *columns):
        table = np.column_stack([sessions, *columns])
        return target - table @ np.linalg.lstsq(table, target, rcond=None)[0]

    command, target, error = (
        np.tile(DRIVE, 2),
        np.concatenate([each.measurement[:, 0] for each in records]),
        np.concatenate(errors)[:, 0],
    )
    power = np.sum([np.var(rows) * len(rows) for rows in np.split(target - (error - left(error)), 2)])
    assert row["gain"] == pytest.approx(1.0 - np.sum(left(target, command) ** 2) / power, rel=1e-9)
    assert row["model"] == pytest.approx(1.0 - np.sum(left(error) ** 2) / power, rel=1e-9)
    assert row["gain"] == pytest.approx(np.var(0.4 * DRIVE) / (np.var(0.4 * DRIVE) + 1.0), abs=0.02)


@pytest.mark.parametrize(
    "model, gain, bad",
    [(0.9, 0.95, True), (0.96, 0.95, False), (0.9995, 0.99999, False), (0.05, 0.0, True), (-3.0, 0.0, True), (0.5, 0.5, False)],
)
def test_the_limits(model, gain, bad):
    row = {"axis": "x", "model": model, "gain": gain}
    assert useless([row]) == ([row] if bad else [])


def test_an_axis_at_rest_is_not_judged():
    still = sampled_record("still", np.zeros((100, 1)), np.zeros((100, 1)), STEP, ("x",), "um", start="settled")
    assert explained_shares([still], [np.zeros((100, 1))]) == []


def test_a_fit_tells_the_whole_drift_of_a_session():
    rows, _ = record_rows(
        gain_model(0.4), [sampled_record("a", DRIVE[:, None], drifting(3.0), STEP, ("x",), "um", start="settled")]
    )
    report = {"family": "linear", "method": "joint", "unit": "um", "records": rows, "parameters": [], "notes": []}
    assert "drift 3 um over the record" in workflow.fit_text(report)


@pytest.fixture
def wrong(monkeypatch):
    """A fit that moves against the records."""
    report = {"family": "linear", "method": "joint", "unit": "um", "records": [], "parameters": [], "notes": ["said before"]}
    monkeypatch.setattr(workflow, "identify", lambda *_, **__: Fit(gain_model(-0.4), dict(report)))


@pytest.mark.parametrize(
    "options, status, kept", [([], 2, False), (["--strict"], 3, False), (["--force"], 0, True), (["--force", "--strict"], 3, True)]
)
def test_a_model_that_explains_nothing_is_said_and_not_written(wrong, options, status, kept, tmp_path, capsys):
    output, json_path = tmp_path / "model.yaml", tmp_path / "fit.json"
    path = bag(tmp_path / "bag", 0.4 * HELD)
    assert main(["identify", path, "--model", "linear", "--output", str(output), "--json", str(json_path), *options]) == status
    assert output.exists() == kept
    document = json.loads(json_path.read_text())
    assert document["verdict"] == "explains_nothing" and document["notes"][1] == "said before"
    [row] = document["explained"]
    assert (
        row["axis"] == "x"
        and row["gain"] == pytest.approx(np.corrcoef(DRIVE, HELD)[0, 1] ** 2, rel=1e-3)
        and row["model"] == pytest.approx(1.0 - 2.0**2, rel=0.1)
    )
    said, told = capsys.readouterr()
    assert told.count("\n") == (0 if kept else 1) and ("hyst identify: x: the model explains -299.9 %" in told) != kept
    assert "x: the model explains -299.9 %" in said and "% of the measured power, a constant and a gain 97.9 %" in said
    assert ("no model is written (--force writes it)" in said) != kept


def test_the_help_names_every_verdict_that_strict_fails(capsys):
    with pytest.raises(SystemExit):
        main(["identify", "--help"])
    told = " ".join(capsys.readouterr().out.split())
    assert all(verdict in told for verdict in (DISAGREE, INVALID, NOTHING, POORLY)) and f"unless the verdict is {EXPLAINS}:" in told


def test_a_caller_that_needs_the_model_is_told(wrong, tmp_path):
    result = identify_bags([bag(tmp_path / "bag", 0.4 * HELD)], "linear", tmp_path / "model.yaml")
    with pytest.raises(InputError, match=r"x: the model explains -(299\.9|300\.0) %"):
        result.written()


@pytest.mark.parametrize("late, verdict, status", [(1, "explains", 0), (3, "records_disagree", 3)])
def test_records_of_two_plants_are_a_verdict_of_their_own(late, verdict, status, tmp_path, monkeypatch, capsys):
    """The same gain, but one answers 2 ms later: too little to be refused, too much for one plant."""
    report = {"family": "linear", "method": "joint", "unit": "um", "records": [], "parameters": [], "notes": []}
    monkeypatch.setattr(workflow, "identify", lambda *_, **__: Fit(gain_model(0.4), dict(report)))
    answers = 0.4 * np.interp(TIME - STEP, TIME, DRIVE), 0.4 * np.interp(TIME - late * STEP, TIME, DRIVE)
    noise = np.random.default_rng(0).normal(scale=0.01, size=(2, len(TIME)))
    bags = [bag(tmp_path / f"bag{k}", answer + noise[k]) for k, answer in enumerate(answers)]
    output, json_path = tmp_path / "model.yaml", tmp_path / "fit.json"
    assert main(["identify", *bags, "--model", "linear", "--output", str(output), "--json", str(json_path), "--strict"]) == status
    document = json.loads(json_path.read_text())
    assert document["verdict"] == verdict and load_model(output)
    assert ("they differ by" in " ".join(document["notes"])) == (verdict == "records_disagree")
    assert capsys.readouterr().err == ""


def test_a_forced_fit_keeps_what_was_found(tmp_path, monkeypatch, capsys):
    report = {"family": "linear", "method": "joint", "unit": "um", "records": [], "parameters": [], "notes": []}
    monkeypatch.setattr(workflow, "identify", lambda *_, **__: Fit(gain_model(0.4), dict(report)))
    path = bag(tmp_path / "bag", 0.4 * DRIVE[::-1])
    output, json_path = tmp_path / "model.yaml", tmp_path / "fit.json"
    words = ["identify", path, "--model", "linear", "--output", str(output), "--json", str(json_path), "--force", "--strict"]
    assert main(words) == 3 and output.exists()
    document = json.loads(json_path.read_text())
    assert document["verdict"] == "invalid_record" and "bag: x: the command explains the measurement when" in document["notes"][0]


@pytest.mark.parametrize("named", [None, "auto", "linear"])
def test_a_choice_between_families_says_that_none_of_them_couples_axes(named, tmp_path, monkeypatch):
    """Several axes that were identified one by one, because nobody named a family."""
    document = {"name": "made", "axes": ["x", "y"], "sample_time": STEP, "units": {"command": "V", "measurement": "um"}}
    model = model_from_document(
        {"format": "hyst_control/model", "version": 1, **document, "chain": [{"stage": "gain", "gain": [0.4, 0.4]}]}
    )
    report = {"family": "made", "method": "joint", "unit": "um", "records": [], "parameters": [], "notes": []}
    monkeypatch.setattr(workflow, "identified", lambda *_, **__: Fit(model, dict(report)))
    command = np.column_stack([DRIVE, DRIVE[::-1]])
    signals = {"command": Signal(TIME, command, ("x", "y"), "V"), "measurement": Signal(TIME, 0.4 * command, ("x", "y"), "um")}
    write_bag(tmp_path / "bag", Record(signals, "made"))
    notes = identify_bags([tmp_path / "bag"], named, tmp_path / "model.yaml").fit.report["notes"]
    told = [note for note in notes if "fitted by themselves" in note]
    assert len(told) == (0 if named == "linear" else 1)
    # None of the families that are compared first couples axes, and those that do are named.
    coupling = {family for name in ("coupled", "cross_coupling") for family in every_option()[name]}
    assert coupling and not any(estimators()[family].suggested for family in coupling)
    assert all(f"--model {family}" in workflow.BY_THEMSELVES for family in coupling)


def test_what_a_model_without_dynamics_leaves_follows_the_frequency(tmp_path, capsys):
    """Play operators on a resonance: they explain far more than a gain, and far less than is possible; the verdict says what is left."""
    num, den = [0.3 * (2 * np.pi * 30) ** 2], [1.0, 2 * 0.1 * 2 * np.pi * 30, (2 * np.pi * 30) ** 2]
    running = Chain((TransferFunction(num, den),)).filter(Sampling(STEP, 1))
    running.settle(DRIVE[:1])
    answer = np.append(0.3 * DRIVE[0], running.process(DRIVE[:, None])[:-1, 0])
    answer += np.random.default_rng(0).normal(scale=1e-3, size=len(answer))
    output, json_path = tmp_path / "model.yaml", tmp_path / "fit.json"
    words = ["identify", bag(tmp_path / "bag", answer), "--output", str(output), "--json", str(json_path)]
    assert main([*words, "--model", "pi", "--strict"]) == 3 and output.exists()
    document = json.loads(json_path.read_text())
    assert document["verdict"] == "explains_poorly"
    assert "a linear model of order" in document["notes"][0] and "follows the command's frequency" in document["notes"][0]
    assert main([*words, "--model", "linear", "--strict"]) == 0
    assert json.loads(json_path.read_text())["verdict"] == "explains"


def test_a_model_is_not_praised_beside_poor_references():
    poor = Poor("x", 0.07, 0.09, "a linear model of order 8", "rate", 0.4, False, True)
    left = "x: explains poorly: 7 % of the range is left on the worst rows"
    assert poor.text() == f"{left}: what is left follows the command's rate (40 % of it)"
    assert f"{left}, where a linear model of order 8 leaves 3 %: what" in replace(poor, reference=0.03).text()


def test_the_references_are_held_against_the_rows_where_the_model_is_worst():
    """A bump in the last rows, which follows nothing: a better fit of the rows before it is no reason to call the model poor."""
    bump = np.where(np.arange(len(DRIVE)) > 8500, 0.4 * np.ptp(DRIVE) * np.sin(np.arange(len(DRIVE)) / 37.0) ** 2, 0.0)
    model = 0.396 * HELD
    record = sampled_record("bumped", DRIVE[:, None], (0.4 * HELD + bump)[:, None], STEP, ("x",), "um", start="settled")
    assert poorly_explained([record], [record.measurement - model[:, None]])[0].reference > 0.05
    sound = sampled_record("sound", DRIVE[:, None], 0.4 * HELD[:, None], STEP, ("x",), "um", start="settled")
    [poor] = poorly_explained([sound], [sound.measurement - 0.3 * HELD[:, None]])
    assert poor.reference < 1e-3 < poor.left and poor.follows


def test_a_mode_that_a_model_lacks_shows_in_the_few_rows_of_its_sweep():
    """Slow loops for a minute, then a small sweep: the error as a whole is less than 1 % of the range."""
    slow, fast = np.arange(60_000) * STEP, np.linspace(0.0, 1.0, 2_000)
    command = np.concatenate([50.0 * np.sin(2 * np.pi * slow), np.sin(2 * np.pi * 250.0 * fast**2)])
    turn = np.exp((-0.02 + 1j) * 2 * np.pi * 180.0 * STEP)
    mode = 0.02 * lfilter([0.0, 1.0], [1.0, -2.0 * turn.real, abs(turn) ** 2], command)
    plain = command * mode.dot(command) / command.dot(command)
    record = sampled_record("sweep", command[:, None], mode[:, None], STEP, ("x",), "um", "zoh", start="settled")
    error = mode - plain
    assert np.std(error) < 0.01 * np.ptp(mode)
    [poor] = poorly_explained([record], [error[:, None]])
    assert poor.linear and poor.reference < 0.2 * poor.left
    assert poorly_explained([record], [0.1 * error[:, None]]) == []


def test_a_hum_does_not_follow_the_command():
    """A reference whose poles ring through the record would make a hum of any beginning, and blame the command's frequency."""
    random = np.random.default_rng(3)
    command = np.repeat(random.uniform(10.0, 90.0, 800), 10)
    answer = 0.1 * lfilter([0.0, 0.2], [1.0, -0.8], command)
    hum = 0.3 * np.sin(2 * np.pi * 50.0 * np.arange(len(command)) * 1e-4 + 0.4)
    record = sampled_record("hum", command[:, None], (answer + hum)[:, None], 1e-4, ("x",), "um", "zoh", "unknown")
    assert poorly_explained([record], [hum[:, None]]) == []
