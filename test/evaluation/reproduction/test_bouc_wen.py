# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The hysteresis benchmark: what is identified from the training record predicts the two others."""

from __future__ import annotations

import numpy as np
import pytest
from measured_here import needs

from evaluation.reproduction import bouc_wen
from evaluation.reproduction.bouc_wen import CANDIDATES, EQUATIONS, interpolated
from hyst_control.base.errors import InputError

benchmark = needs("bouc_wen")


@pytest.fixture(scope="module")
def outcome():
    """The gray box and a small table, with two fifths of the points of interpolation."""
    grey = bouc_wen.Candidate(CANDIDATES[0].subject, "bouc_wen", {"exponent": 1.0})
    generic = bouc_wen.Candidate(CANDIDATES[1].subject, "duhem_oscillator", {"table_size": 3})
    return bouc_wen.run(None, (grey, generic), refinement=4)


@benchmark
@pytest.mark.parametrize("case", ["multisine", "sine sweep"])
def test_both_oscillators_keep_their_targets(outcome, case):
    assert outcome.value(case, CANDIDATES[0].subject, "rms_error") <= 3e-6
    assert outcome.value(case, CANDIDATES[1].subject, "rms_error") <= 1.2e-5


@benchmark
def test_the_training_record_is_fitted_to_its_noise(outcome):
    for candidate in CANDIDATES[:2]:
        noise = outcome.value("multisine_train", candidate.subject, "noise_of_the_mean_period")
        assert outcome.value("multisine_train", candidate.subject, "rms_error") == pytest.approx(noise, rel=0.03)


@benchmark
def test_the_parameters_are_those_of_the_equations(outcome):
    for name, true in EQUATIONS.items():
        if name != "exponent":  # which was given
            assert outcome.value(name, CANDIDATES[0].subject, name) == pytest.approx(true, rel=0.02), name


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
