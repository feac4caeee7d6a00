# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Rows of a gap report on coefficients that an identification found to scatter together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lsim

import hyst_control as hc
from hyst_control.diagnose.report.coefficient_changes import coefficient_changes, strain

RATE = 2000.0


def record(frequency: float, seed: int) -> hc.Record:
    """A mode driven by a sum of sines that fades in, with noise."""
    random, time = np.random.default_rng(seed), np.arange(6000) / RATE
    lines = np.arange(2.0, 250.0, 3.0)
    command = sum(np.cos(2 * np.pi * f * time + random.uniform(0, 2 * np.pi)) for f in lines) * np.minimum(time / 0.1, 1.0)
    rate = 2 * np.pi * frequency
    _, measurement, _ = lsim(([0.5 * rate**2], [1.0, 0.06 * rate, rate**2]), command, time)
    return hc.from_arrays(command, measurement + 0.003 * random.standard_normal(len(time)), RATE)


@pytest.fixture(scope="module")
def gap():
    model = hc.identify(record(100.0, 1), "linear", verbose=False)
    wider = {**model.uncertainty, "factor": (2000.0 * np.array(model.uncertainty["factor"])).tolist()}
    return hc.diagnose(record(100.5, 2), replace(model, uncertainty=wider), verbose=False)


def test_every_number_is_told_with_the_way_that_it_went(gap):
    """Not a direction in which several scatter, by the name of one that may have gone the other way."""
    rows = coefficient_changes(gap.diagnosis)
    known = gap.diagnosis.model.uncertainty["parameters"]
    assert sorted(row.name for row in rows) == sorted(name.partition(".")[2] for name in known)
    factor = {name.partition(".")[2]: row for name, row in zip(known, gap.diagnosis.model.uncertainty["factor"], strict=True)}
    for row in rows:
        assert row.after - row.before == pytest.approx(row.deviations * np.linalg.norm(factor[row.name]), rel=1e-6, abs=1e-12)
    moved = max(rows, key=lambda row: abs(row.deviations))
    assert moved.name == "frequency[0]" and moved.after == pytest.approx(100.5, abs=0.05)


def test_what_is_told_as_off_lies_outside_its_interval(gap):
    told = gap.document["parameters"]
    assert "frequency[0]" in {row["name"] for row in told}
    for row in told:
        assert not row["ci90"][0] <= row["nominal"] <= row["ci90"][1]
        assert row["z"] * (row["value"] - row["nominal"]) > 0.0
    # By Cauchy and Schwarz no number alone is further off than all of them together.
    assert strain(gap.diagnosis) == gap.document["strain"] >= max(abs(row["z"]) for row in told)


def test_a_number_may_be_far_off_that_an_identification_told_exactly():
    """A mode half a percent higher, of a model that knows it to a millionth: no other effect, and nothing unknown."""
    model = hc.identify(record(100.0, 1), "linear", verbose=False)
    away = ["added_mass", "softening_modes", "resonance", "delay", "cubic_stiffness"]
    gap = hc.diagnose(record(100.5, 2), model, without=away, verbose=False)
    assert gap.document["verdict"] == "parameters"
    (row,) = [row for row in gap.document["parameters"] if row["name"] == "frequency[0]"]
    assert row["value"] == pytest.approx(100.5, abs=0.01) and row["z"] > 1000.0
