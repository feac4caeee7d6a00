# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Hypotheses on a change between levels, on responses whose poles are known."""

from __future__ import annotations

import numpy as np
import pytest

from evaluation.reproduction import mirror_levels
from evaluation.reproduction.mirror_levels import modal_response, moved_poles, predicted, residues, shifts, vector_fit

RATE = 2 * np.pi * np.linspace(50.0, 1500.0, 900)
POLES = np.array([-20.0 + 1j * 2 * np.pi * f for f in (300.0, 620.0, 1100.0)])
RANDOM = np.random.default_rng(3)
HELD = np.concatenate([1e3 * (RANDOM.standard_normal((3, 3, 3)) * 1j), 0.01 * np.ones((1, 3, 3), complex)])


def test_vector_fitting_finds_the_poles(monkeypatch):
    monkeypatch.setattr(mirror_levels, "PAIRS", 3)
    found = vector_fit(modal_response(RATE, POLES, HELD, POLES), RATE)
    np.testing.assert_allclose(found, POLES, rtol=1e-6)
    np.testing.assert_allclose(
        residues(modal_response(RATE, POLES, HELD, POLES), RATE, found), HELD, atol=1e-5 * np.abs(HELD).max()
    )


@pytest.mark.parametrize(
    "hypothesis, values",
    [
        ("common factor", [-0.06]),
        ("factor per input", [-0.06, 0.02, 0.1]),
        ("clock", [0.01]),
        ("softening of all modes alike", [0.01, 0.2]),
        ("shift per mode", [0.01, 0.0, 0.005, 0.1, 0.3, 0.0]),
    ],
)
def test_a_hypothesis_finds_its_own_numbers_and_no_other_explains_them(hypothesis, values):
    target = predicted(hypothesis, RATE, POLES, HELD, np.array(values))
    found = shifts(hypothesis, RATE, POLES, HELD, target)
    np.testing.assert_allclose(found, values, atol=0.02 * np.abs(values).max())
    simpler = "clock" if "factor" in hypothesis else "common factor"
    left = np.std(target - predicted(simpler, RATE, POLES, HELD, shifts(simpler, RATE, POLES, HELD, target)))
    assert np.std(target - predicted(hypothesis, RATE, POLES, HELD, found)) < 0.1 * left


def test_a_clock_moves_all_poles_alike():
    np.testing.assert_allclose(moved_poles("clock", POLES, np.array([0.01])), 0.99 * POLES)
