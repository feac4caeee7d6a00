# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""What a diagnosis says of truth plants whose gap is known."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import yaml

from hyst_control.base import parallel
from hyst_control.base.config_files import config_path
from hyst_control.base.files import write_json
from hyst_control.diagnose.workflow import diagnosed
from hyst_control.effects import EFFECTS
from hyst_control.model_file import load_model, save_model, simulate
from test.diagnose.conftest import all_but, nominal, record_of

pytestmark = pytest.mark.long_file

PEA, FSM = "pea_published", "fsm_published"
DELAY = (("name", "delay"), ("tau", 2e-4))
BACKLASH = (("name", "backlash"), ("half_width", 0.03))
SINGLES = [
    (PEA, DELAY),
    (PEA, (("name", "amplifier_lowpass"), ("cutoff", 900.0), ("order", 2))),
    (PEA, (("name", "resonance"), ("frequency", 700.0), ("damping", 0.03), ("gain", 0.03))),
    (PEA, BACKLASH),
    (PEA, (("name", "held_samples"), ("fraction", 0.1))),
    (PEA, (("name", "quantization"), ("step", 0.03))),
    (FSM, (("name", "sensor_lowpass"), ("cutoff", 700.0))),
]
RIVALS = (
    *("delay", "amplifier_lowpass", "sensor_lowpass", "slew_limit", "resonance", "backlash", "hysteresis_width", "creep", "gain"),
    *("held_samples", "dac_hold", "quantization", "sensor_noise"),
)
"""Effects that are looked for beside a single one of the stage; the delay, the mirror's and the blind test's are among all."""


@pytest.mark.parametrize("plant", [PEA, FSM])
def test_a_plant_that_is_the_model_has_no_gap(answer, plant):
    document, _, better = answer(plant)
    assert (document["verdict"], document["effects"], better) == ("no_gap", [], None)


@pytest.mark.parametrize("plant, effect", SINGLES, ids=lambda value: dict(value)["name"] if isinstance(value, tuple) else value)
def test_an_effect_is_named_and_sized(answer, plant, effect):
    """The name, and every parameter within three of its intervals or 10 %."""
    truth = dict(effect)
    document, _, _ = answer(plant, effect, without=all_but(*RIVALS) if plant == PEA and effect != DELAY else ())
    assert document["verdict"] in ("effect", "ambiguous")
    named = {row["name"]: row for row in document["effects"]}
    assert truth["name"] in named
    assert named[truth["name"]]["probability"] == max(row["probability"] for row in document["effects"])
    for name, row in named[truth["name"]]["parameters"].items():
        if name in truth:
            low, high = row["ci90"]
            assert low <= row["value"] <= high
            assert abs(row["value"] - truth[name]) <= max(1.5 * (high - low), 0.1 * abs(truth[name])), (name, row)


def test_creep_is_named_where_the_tolerances_leave_it_room():
    """With 1 % throughout; the shipped, wider tolerances let the slow end of the transfer function take creep up."""
    model = nominal(PEA)
    model = replace(model, tolerance=dict.fromkeys(model.tolerance, 0.01))
    without = all_but(
        "creep", "offset_drift", "gain_drift", "hysteresis_width", "hysteresis_rate", "gain", "delay", "sensor_lowpass"
    )
    document, _, _ = diagnosed([record_of(PEA, [{"name": "creep", "gamma": 0.03}])], model, without=without)
    (named,) = document["effects"]
    assert (document["verdict"], named["name"]) == ("effect", "creep")
    assert named["parameters"]["gamma"]["value"] == pytest.approx(0.03, rel=0.1)


@pytest.mark.parametrize("name, change, tau", [("offset_drift", -0.15, 0.1), ("gain_drift", 0.03, 0.3)])
def test_a_drift_that_ends_within_the_record_is_named(answer, name, change, tau):
    """Straight for this time of the 0.34 s, then constant (law 1 of the plant)."""
    without = all_but("offset_drift", "gain_drift", "creep", "offset", "gain", "hysteresis_width", "sensor_nonlinearity", "delay")
    document, _, _ = answer(PEA, (("name", name), ("change", change), ("tau", tau), ("law", 1)), without=without)
    assert (document["verdict"], [row["name"] for row in document["effects"]]) == ("effect", [name])
    assert document["effects"][0]["parameters"]["change"]["value"] == pytest.approx(change, rel=0.1)


def test_two_effects_are_both_named(answer):
    without = all_but("delay", "backlash", "sensor_lowpass", "amplifier_lowpass", "gain", "hysteresis_width", "creep", "dac_hold")
    document, _, _ = answer(PEA, DELAY, BACKLASH, without=without)
    assert {row["name"] for row in document["effects"]} >= {"delay", "backlash"}
    assert sum(row["share"] for row in document["effects"]) == pytest.approx(1.0)


def test_noise_has_its_share_of_the_gap_and_stands_behind_what_is_more(answer):
    without = all_but(
        "delay", "sensor_noise", "flicker_noise", "quantization", "sensor_lowpass", "amplifier_lowpass", "gain", "creep"
    )
    document, _, _ = answer(PEA, DELAY, (("name", "sensor_noise"), ("rms", 0.03)), without=without)
    assert [row["name"] for row in document["effects"]] == ["delay", "sensor_noise"]
    shares = [row["share"] for row in document["effects"]]
    assert shares[0] == pytest.approx(1.0) and shares[1] == pytest.approx((0.03 / document["gap"]["rms"]) ** 2, rel=0.1)


def test_a_second_effect_is_named_beside_one_that_takes_off_a_thousand_times_as_much():
    """The slew limit alone leaves some noise and coefficients far off; creep brings them back, in a record that is long beside it."""
    record = record_of(PEA, [{"name": "slew_limit", "rate": 34000.0}, {"name": "creep", "gamma": 0.032}], duration=0.7)
    without = all_but("slew_limit", "creep", "amplifier_lowpass", "delay", "gain", "offset_drift")
    document, found, _ = diagnosed([record], nominal(PEA), without=without)
    assert document["verdict"] == "effect"
    assert {row["name"] for row in document["effects"]} == {"slew_limit", "creep"}
    z = found.parts[0].chosen.solution.z
    assert z @ z < len(z) + 4.0 * np.sqrt(2.0 * len(z))


def test_a_withheld_effect_is_not_replaced_with_certainty(answer):
    """With backlash out of the catalogue nothing in it may be called the cause for sure and explain the gap away.

    Nor dry friction, whose slack is a play of the mechanics too.
    """
    rivals = ("hysteresis_width", "hysteresis_rate", "hysteresis_shape", "creep", "delay", "gain", "dead_zone", "clearance")
    document, _, _ = answer(PEA, BACKLASH, without=all_but(*rivals, "sensor_nonlinearity", "resonance", "quantization"))
    assert "backlash" not in {row["name"] for row in document["candidates"]}
    assert document["verdict"] in ("unknown", "ambiguous", "parameters")


def test_coefficients_beyond_their_tolerance_are_called_parameters():
    """Every play of the hysteresis 6 % off, where the model's tolerance is 1 %."""
    weights = yaml.safe_load(config_path("plants/pea_published.yaml").read_text())["parameters"]["weights"]
    signs = np.where(np.arange(len(weights)) % 2, 1.0, -1.0)
    record = record_of(PEA, [], weights=[float(w * (1 + 0.06 * s)) for w, s in zip(weights, signs, strict=True)])
    document, _, _ = diagnosed([record], nominal(PEA))
    assert document["verdict"] == "parameters"
    assert not document["effects"]


def test_the_report_has_the_form_of_the_interface(answer):
    document, _, _ = answer(PEA, DELAY)
    assert (document["schema"], document["version"]) == ("hyst_control/gap-report", 1)
    assert set(document) >= {"verdict", "gap", "where", "effects", "candidates", "parameters", "next_experiment", "augmented_model"}
    assert set(document["gap"]) >= {"rms", "nrmse", "floor_rms", "unit"} and document["gap"]["unit"] == "um"
    assert set(document["where"]) == {"stage", "kind", "band", "amplitude", "axis", "time"}
    for rows in document["where"].values():
        assert sum(row["share"] for row in rows) == pytest.approx(1.0)
        for row in rows:
            low, high = row["ci90"]
            assert 0.0 <= low <= row["share"] + 1e-12 <= high + 2e-12 <= 1.0 + 1e-9, row
    for row in document["effects"]:
        assert row["name"] in EFFECTS and set(row) >= {
            "equivalent",
            "parameters",
            "rms_before",
            "rms_after",
            "shrink",
            "shrink_ci90",
            "shrink_reidentified",
            "share",
        }
        assert row["shrink_ci90"][0] <= row["shrink"] <= row["shrink_ci90"][1] <= 1.0
        assert row["rms_after"] < row["rms_before"] == pytest.approx(document["gap"]["rms"], rel=0.02)
    assert all(0.0 <= row["probability"] <= 1.0 for row in (*document["effects"], *document["candidates"]))
    assert set(document["parameters"][0] if document["parameters"] else ("name", "z")) == {"name", "z"}


def test_the_gap_is_what_a_simulation_leaves(answer):
    """gap.rms against the plain simulation of the model file."""
    document, diagnosis, _ = answer(PEA, DELAY)
    piece = diagnosis.problem.pieces[0]
    left = piece.measurement - simulate(diagnosis.model, piece.command, diagnosis.problem.sample_time)
    assert document["gap"]["rms"] == pytest.approx(float(np.sqrt(np.mean(left**2))), rel=1e-6)
    assert document["gap"]["nrmse"] == pytest.approx(100 * document["gap"]["rms"] / float(np.ptp(piece.measurement)), rel=1e-6)


def test_the_same_answer_on_every_run_and_any_number_of_cores(answer, tmp_path, monkeypatch):
    document, _, _ = answer(PEA, DELAY)
    monkeypatch.setattr(parallel, "_serial", False)
    monkeypatch.setattr(parallel, "cores", lambda: 2)
    again, _, _ = diagnosed([record_of(PEA, [dict(DELAY)])], nominal(PEA))
    write_json(tmp_path / "one.json", document)
    write_json(tmp_path / "two.json", again)
    assert (tmp_path / "one.json").read_bytes() == (tmp_path / "two.json").read_bytes()
    assert json.loads((tmp_path / "one.json").read_text()) == document


def test_the_augmented_model_closes_the_gap(answer, tmp_path):
    """Saved, loaded, simulated on another record of the same plant: less is left; and a diagnosis with it finds no further gap."""
    document, _, better = answer(PEA, DELAY)
    save_model(better, tmp_path / "better.yaml")
    loaded = load_model(tmp_path / "better.yaml")
    record = record_of(PEA, [dict(DELAY)], seed=11)
    command, measured = record.signal("command").values, record.signal("measurement").values
    left = float(np.sqrt(np.mean((measured - simulate(loaded, command, 5e-5)) ** 2)))
    assert left < 0.3 * document["gap"]["rms"]
    second, _, _ = diagnosed([record], loaded)
    assert second["verdict"] == "no_gap"
