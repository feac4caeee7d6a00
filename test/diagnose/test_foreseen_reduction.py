# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""What is foreseen on a command that was not played yet, against the record of it that is then made."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest

from evaluation.blind_test.case import Case
from evaluation.blind_test.case_records import record_of, run_case
from evaluation.blind_test.nominal_models import nominal
from evaluation.blind_test.plant_setups import SETUPS
from evaluation.blind_test.run import _diagnose_one, _make_one, _realize_one
from hyst_control.base.errors import InputError
from hyst_control.cli import main
from hyst_control.diagnose import workflow
from hyst_control.diagnose.model_error.baseline import Baseline
from hyst_control.diagnose.report.predicted_reduction import foresee, own_error_energy
from hyst_control.diagnose.run.diagnosis import outside_valid
from hyst_control.diagnose.workflow import diagnosed
from hyst_control.effects import EFFECTS
from hyst_control.identify.model_error.learned_discrepancy import learn
from hyst_control.model_file import save_model, simulate
from hyst_control.records.record import Record
from hyst_control.records.session_zero import without_zero
from hyst_control.records.tables.importing import write_bag

pytestmark = pytest.mark.long_file

NOISE = 5e-4
DRAWN = {"pea_published": {"name": "dac_hold", "samples": 4.0}, "fsm_published": {"name": "cross_coupling", "coupling": 0.03}}

RIVALS = {"dac_hold", "cross_coupling", "delay", "gain", "backlash", "resonance", "sensor_lowpass"}
"""Effects that are looked for: how far the gap shrinks on another command is asked of the one that is named."""
DURATION = {"pea_published": 1.5, "fsm_published": 0.75}
"""s; of the stage as long as its shrink on the record itself is another one than on the command to come."""


@pytest.fixture(scope="module")
def answer():
    """Case, record, model, report, diagnosis and augmented model by plant."""

    @cache
    def found(plant):
        case = Case("case", plant, "single", "rich", NOISE, 21, (DRAWN[plant],), duration=DURATION[plant])
        model, record = nominal(plant, NOISE), record_of(case, run_case(case))
        return case, record, model, *diagnosed([record], model, without=[name for name in EFFECTS if name not in RIVALS])

    return found


@pytest.mark.parametrize("plant", DRAWN)
def test_the_shrink_foreseen_is_the_one_then_measured(plant, answer):
    case, _, model, document, diagnosis, better = answer(plant)
    fresh = run_case(replace(case, excitation="multisine"))
    foreseen = foresee(diagnosis, fresh["command"])
    floor = (NOISE * SETUPS[plant].stroke) ** 2
    before, after = (np.sqrt(np.mean((fresh["measurement"] - simulate(m, fresh["command"])) ** 2) - floor) for m in (model, better))
    assert foreseen.rms_before == pytest.approx(before, rel=0.03) and foreseen.rms_after == pytest.approx(after, rel=0.1)
    assert foreseen.shrink == pytest.approx(1 - (after / before) ** 2, abs=0.02)
    part = diagnosis.parts[0]
    stated = replace(part.problem.model, noise={"sigma": 3.0 * NOISE * SETUPS[plant].stroke})
    louder = replace(part, problem=replace(part.problem, model=stated))  # a model that says that it leaves thrice the noise
    own = [own_error_energy(one, fresh["command"][:, list(part.axes)]) for one in (part, louder)]
    assert own[0] < 0.2 * np.sum(part.problem.sigma**2)
    assert own[1] == pytest.approx(np.sum(9.0 * floor - part.problem.sigma**2), rel=1e-6)
    if plant == "pea_published":  # on the record itself it is another one: another command excites other things
        assert abs(document["effects"][0]["shrink"] - foreseen.shrink) > 0.2


def test_a_line_is_in_the_gap_of_another_session_whatever_was_found(tmp_path):
    """The mains have another phase a day later, so that no model foresees them: their energy is what both gaps have.

    With the phase of the diagnosed record the line doubles it on average, and is no prediction.
    """
    amplitude, frequency = 0.03, 50.0
    hum = {"name": "mains_hum", "amplitude": amplitude, "frequency": frequency}
    case = Case("case", "pea_published", "single", "rich", NOISE, 21, (hum,), off=0.0, duration=0.75)
    report, file = tmp_path / "reports" / "case.json", tmp_path / "case" / "model.yaml"
    report.parent.mkdir()
    _make_one((case, tmp_path))
    _diagnose_one(
        (str(tmp_path / "case"), str(report), tuple(name for name in EFFECTS if name not in ("mains_hum", "delay")), "rules")
    )
    _realize_one((case, report, file))
    found = json.loads(report.read_text())
    assert [effect["name"] for effect in found["effects"]] == ["mains_hum"] and found["effects"][0]["shrink"] > 0.95

    fresh = replace(case, excitation="multisine")
    first, later = (
        run_case(fresh, noisy=False, later=other)["measurement"]
        - run_case(fresh, effects=False, noisy=False, later=other)["measurement"]
        for other in (False, True)
    )
    energy = 0.5 * amplitude**2 * (1.0 + 0.3**2 + 0.1**2)
    assert np.mean(first**2) == pytest.approx(energy, rel=0.01) and np.mean(later**2) == pytest.approx(energy, rel=0.01)
    assert np.mean((later - first) ** 2) > 0.1 * energy  # another phase, of the same plant
    assert found["foreseen"]["rms_before"] == pytest.approx(np.sqrt(energy), rel=0.03)
    assert found["foreseen"]["shrink"] == pytest.approx(0.0, abs=0.02)
    assert found["shrink_realised"][1] == pytest.approx(0.0, abs=0.02)


def test_the_command_line_tells_what_is_foreseen(answer, tmp_path, capsys, monkeypatch):
    """Bag, model and command go in, and the figure of `foresee` comes out; the diagnosis itself is the one made above."""
    case, record, model, document, diagnosis, better = answer("pea_published")
    command = run_case(replace(case, excitation="multisine"))["command"]

    def known(records, nominal, **_):
        np.testing.assert_array_equal(records[0].signal("command").values, record.signal("command").values)
        assert nominal == model
        return dict(document), diagnosis, better

    monkeypatch.setattr(workflow, "diagnosed", known)
    write_bag(tmp_path / "bag", record)
    save_model(model, tmp_path / "model.yaml")
    np.save(tmp_path / "next.npy", command)
    files = {"--model": "model.yaml", "--on": "next.npy", "--json": "gap.json"}
    options = [word for option, name in files.items() for word in (option, str(tmp_path / name))]
    assert main(["diagnose", str(tmp_path / "bag"), *options]) == 0
    told = json.loads((tmp_path / "gap.json").read_text())["foreseen"]
    assert told["shrink"] == pytest.approx(foresee(diagnosis, command).shrink, abs=1e-6)
    assert f"a reduction of {100 * told['shrink']:.1f} %" in capsys.readouterr().out


def test_a_command_of_another_form_is_refused(answer):
    diagnosis = answer("fsm_published")[4]
    for command in (np.zeros((100, 1)), np.zeros(100), np.full((100, 2), np.nan)):
        with pytest.raises(InputError, match="must be finite rows of 2 axes"):
            foresee(diagnosis, command)


def test_the_own_error_on_a_command_to_come_is_predicted_from_what_others_taught():
    """An error that is known in closed form, learned on two commands, against its mean square on a third one."""
    step, time = 1e-3, 1e-3 * np.arange(6000)
    commands = [
        (size * np.sin(2 * np.pi * f * time) * np.cos(2 * np.pi * 0.2 * time))[:, None]
        for size, f in ((40.0, 1.0), (25.0, 2.0), (33.0, 1.5))
    ]
    errors = [0.2 * (u / 40.0) ** 2 + 0.1 * (u / 40.0) ** 3 for u in commands]
    noisy = [e + 0.005 * np.random.default_rng(i).standard_normal(e.shape) for i, e in enumerate(errors)]
    learned = learn([u[:, 0] for u in commands[:2]], [e[:, 0] for e in noisy[:2]], step)
    assert learned is not None
    no_problem = SimpleNamespace()
    known = Baseline(no_problem, False, np.zeros(1), np.zeros((1, 3)), np.zeros(1), None, np.array([0.05]), learned)
    true = float(np.mean(without_zero(errors[2])[0] ** 2))
    assert known.error_energy(commands[2], step) == pytest.approx(true, rel=0.3)
    assert replace(known, learned=None).error_energy(commands[2], step) == pytest.approx(0.05**2)


@pytest.fixture
def diagnosed_bag(answer, tmp_path, monkeypatch):
    """`hyst diagnose` of a record as named fields, with the diagnosis made above; how often that was asked for; and the record."""
    _, record, model, document, diagnosis, better = answer("pea_published")
    asked = []

    def known(*_, **__):
        asked.append(1)
        return dict(document, notes=list(document["notes"])), diagnosis, better

    monkeypatch.setattr(workflow, "diagnosed", known)
    signals = {{"command": "drive", "measurement": "sensor"}[name]: signal for name, signal in record.signals.items()}
    write_bag(tmp_path / "bag", replace(record, signals=signals))
    save_model(model, tmp_path / "model.yaml")
    command = ["diagnose", str(tmp_path / "bag"), "--model", str(tmp_path / "model.yaml")]
    return lambda *more: main([*command, "--columns", "command=/drive.x[V],measurement=/sensor.x[um]", *more]), asked, record


def test_a_command_in_foreign_fields_is_read_by_the_same_columns(diagnosed_bag, tmp_path, capsys):
    call, _, _ = diagnosed_bag
    assert call("--on", str(tmp_path / "bag")) == 0
    told = capsys.readouterr().out
    assert f"on {tmp_path / 'bag'}: a gap of" in told and "valid for" not in told


def test_a_command_of_another_sample_time_is_refused_before_the_diagnosis(diagnosed_bag, tmp_path, capsys):
    call, asked, record = diagnosed_bag
    slow = replace(record.signal("command"), time=2.0 * record.signal("command").time)
    write_bag(tmp_path / "slow", Record({"drive": slow, "sensor": slow}, "slow"))
    rate = 1.0 / record.common_step(["command"])
    assert call("--on", str(tmp_path / "slow")) == 2 and not asked
    told = capsys.readouterr().err.splitlines()[-1]
    assert f"has {0.5 * rate:.6g} samples/s, the records {rate:.6g}" in told and f"--resample {rate:.6g}" in told


def test_a_command_in_millivolts_is_noted_as_beyond_the_valid_range(diagnosed_bag, tmp_path, capsys):
    call, _, record = diagnosed_bag
    np.save(tmp_path / "mV.npy", 1e3 * record.signal("command").values)
    assert call("--on", str(tmp_path / "mV.npy")) == 0
    assert "of the command lies outside the 0 … 50 V that the model is valid for" in capsys.readouterr().out


@pytest.mark.parametrize("option", ["--report", "--augmented", "--json"])
def test_an_output_that_cannot_be_written_is_refused_before_the_diagnosis(diagnosed_bag, tmp_path, capsys, option):
    call, asked, _ = diagnosed_bag
    assert call(option, str(tmp_path)) == 2 and not asked
    assert capsys.readouterr().err.splitlines()[-1].endswith(f"{tmp_path}: is a directory: give the name of a file")


@pytest.mark.parametrize(
    "valid, told", [([0.0, 50.0], "25.0% of the command lies outside the 0 … 50 V"), ([[0.0, 50.0], [0.0, 90.0]], "")]
)
def test_a_range_of_all_axes_or_of_each(valid, told):
    model = SimpleNamespace(valid={"command": valid})
    found = outside_valid(model, np.array([[10.0, 20.0], [30.0, 80.0]]))
    assert found.startswith(told) and bool(found) == bool(told)
