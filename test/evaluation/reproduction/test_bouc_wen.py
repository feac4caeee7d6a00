# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The hysteresis benchmark: what is identified from the training record predicts the two others."""

from __future__ import annotations

import json

import numpy as np
import pytest
from measured_here import needs

from evaluation.reproduction import bouc_wen
from evaluation.reproduction.bouc_wen import CANDIDATES, EQUATIONS, TARGETS, interpolated
from hyst_control.base.errors import InputError

benchmark = needs("bouc_wen")


@pytest.fixture(scope="module")
def outcome(tmp_path_factory):
    """The gray box and a small table, with half of the points of interpolation."""
    path = tmp_path_factory.mktemp("bouc_wen") / "table.json"
    grey = bouc_wen.Candidate(CANDIDATES[0].subject, "bouc_wen", {"exponent": 1.0})
    generic = bouc_wen.Candidate(CANDIDATES[1].subject, "duhem_oscillator", {"table_size": 3})
    return bouc_wen.run(path, path.parent, (grey, generic), refinement=5), path


@benchmark
@pytest.mark.parametrize("case", ["multisine", "sine sweep"])
def test_both_oscillators_keep_their_targets(outcome, case):
    table, _ = outcome
    assert table.value(case, CANDIDATES[0].subject, "rms_error") <= TARGETS["gray box"]
    assert table.value(case, CANDIDATES[1].subject, "rms_error") <= TARGETS["generic"]


@benchmark
def test_the_training_record_is_fitted_to_its_noise(outcome):
    table, _ = outcome
    for candidate in CANDIDATES[:2]:
        noise = table.value("multisine_train", candidate.subject, "noise_of_the_mean_period")
        assert table.value("multisine_train", candidate.subject, "rms_error") == pytest.approx(noise, rel=0.03)


@benchmark
def test_the_parameters_are_those_of_the_equations(outcome):
    table, _ = outcome
    for name, true in EQUATIONS.items():
        if name != "exponent":  # which was given
            assert table.value(name, CANDIDATES[0].subject, name) == pytest.approx(true, rel=0.02), name


@benchmark
def test_the_table_and_the_figure_are_written(outcome):
    table, path = outcome
    document = json.loads(path.read_text())
    assert document["source"] == "reproduce bouc-wen" and len(document["rows"]) == len(table.rows)
    assert (path.parent / "bouc_wen.png").stat().st_size > 10_000


def test_interpolation_is_exact_below_half_the_sample_rate():
    phase = 2 * np.pi * np.arange(640) / 640
    fine = 1.0 + np.cos(3 * phase + 0.4) - 2.0 * np.sin(31 * phase)
    np.testing.assert_allclose(interpolated(fine[::10], 10), fine, atol=1e-12)


def test_absent_records_are_one_clear_line(monkeypatch, tmp_path):
    monkeypatch.setenv("HYST_DATA", str(tmp_path))
    with pytest.raises(InputError, match="bouc_wen: the measurements are not in"):
        bouc_wen.run()
    (tmp_path / "bouc_wen").mkdir()
    np.save(tmp_path / "bouc_wen" / "multisine_train.npy", np.zeros((3, 2)))
    with pytest.raises(InputError, match="multisine_train.npy: shape"):
        bouc_wen.run()
