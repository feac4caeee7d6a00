# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Diagnosis by the likelihood core on records of truth plants, with and without baseline records."""

from dataclasses import replace

import numpy as np
import pytest

from hyst_control.diagnose.workflow import diagnosed
from hyst_control.records.record import Record
from test.diagnose.conftest import all_but, nominal, record_of

FEW = all_but("delay", "gain", "backlash", "sensor_lowpass", "flicker_noise", "sensor_noise")


def said(record: Record, **settings: object) -> dict:
    """Report by the likelihood core, of a few effects."""
    return diagnosed([record], nominal("pea_published"), core="likelihood", without=FEW, **settings)[0]


def names(report: dict) -> list[str]:
    """Names of the report."""
    return [effect["name"] for effect in report["effects"]]


def test_a_record_without_a_gap():
    report = said(record_of("pea_published", []))
    assert (report["verdict"], names(report), report["reasons"]) == ("no_gap", [], ["below_null"])


def test_a_delay_with_an_interval_that_holds_it():
    report = said(record_of("pea_published", [{"name": "delay", "tau": 2e-4}]))
    assert (report["verdict"], names(report)) == ("effect", ["delay"])
    tau = report["effects"][0]["parameters"]["tau"]
    assert tau["ci90"][0] <= 2e-4 <= tau["ci90"][1]
    assert report["effects"][0]["shrink"] > 0.9


def test_noise_that_falls_with_frequency_is_a_hypothesis_like_others():
    report = said(record_of("pea_published", [{"name": "flicker_noise", "rms": 0.02}]))
    assert (report["verdict"], names(report)) == ("effect", ["flicker_noise"])


def test_an_effect_that_is_not_in_the_catalogue_is_something_else_and_has_a_structure():
    record = record_of("pea_published", [{"name": "duffing_stiffness", "share": 0.2}])
    report = said(record)
    assert (report["verdict"], report["reasons"]) == ("unknown", ["something_else"])
    assert report["novelty"] > 0.5
    questions = {row["question"]: row["probability"] for row in report["structure"]}
    assert {"memory", "even", "rate", "slow", "clock"} <= set(questions)
    assert all(0.0 <= probability <= 1.0 for probability in questions.values())


@pytest.mark.parametrize(("effects", "verdict"), [([], "no_gap"), ([{"name": "backlash", "half_width": 0.03}], "effect")])
def test_beside_a_baseline_record_of_the_same_command(effects, verdict):
    clean = record_of("pea_published", [], seed=5)
    record = record_of("pea_published", effects)
    report = said(_bent(record), baseline=[_bent(clean)])
    assert report["verdict"] == verdict
    assert report["baseline"]["same_command"]
    assert names(report) == [effect["name"] for effect in effects]


def _bent(record: Record) -> Record:
    """A record through a sensor's curve that no model here has: a discrepancy of both records."""
    measured = record.signal("measurement")
    bent = replace(measured, values=measured.values + 0.02 * np.sin(3.0 * measured.values))
    return replace(record, signals={**record.signals, "measurement": bent})
