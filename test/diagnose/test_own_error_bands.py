# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Excess of a residual over the model discrepancy: none under it, and far beyond it hardly more than the logarithm."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hyst_control.chain import Chain
from hyst_control.chain.memoryless import Gain
from hyst_control.diagnose.model_error.excess_over_error import beyond_own_error
from hyst_control.diagnose.problem.problem import Piece, Problem
from hyst_control.model_file import Model

COUNT = 4096


@pytest.fixture
def problem():
    model = Model("a", ("x",), {"command": "V", "measurement": "um"}, 1e-3, Chain((Gain(1.0),)))
    piece = Piece(np.zeros((COUNT, 1)), np.zeros((COUNT, 1)))
    return Problem(model, (piece, piece), 1e-3, "zoh", np.ones(1))


def cosine(k: int, energy: float) -> np.ndarray:
    """Bin k of a record's cosine transform, of some energy."""
    return np.sqrt(energy * 2.0 / COUNT) * np.cos(np.pi * k * (np.arange(COUNT) + 0.5) / COUNT)


def test_what_stays_under_the_own_error_is_nothing(problem):
    quiet = 0.9 * np.random.default_rng(1).normal(size=2 * COUNT)
    octaves = np.concatenate([[0.0] * 64, quiet[64:]])  # few bins exceed their mean by chance
    assert beyond_own_error(problem, np.zeros(2 * COUNT)) == 0.0
    assert beyond_own_error(problem, 0.5 * octaves) == 0.0


@pytest.mark.parametrize(("k", "bins"), [(2, 4), (5, 4), (9, 8), (40, 32), (3000, 2048)])
def test_a_line_counts_by_how_far_it_exceeds_its_octave(problem, k, bins):
    """Student's t of an octave whose scale is known by three degrees of freedom."""
    for energy, expected in ((0.9 * bins, 0.0), (10.0 * bins, 0.5 * (3 + bins) * np.log((3 + 10 * bins) / (3 + bins)))):
        flat = np.concatenate([np.zeros(COUNT), cosine(k, energy)])
        assert beyond_own_error(problem, flat) == pytest.approx(expected, abs=1e-6)


def test_records_and_axes_add(problem):
    line = cosine(9, 200.0)
    one = beyond_own_error(problem, np.concatenate([line, np.zeros(COUNT)]))
    assert beyond_own_error(problem, np.concatenate([line, line])) == pytest.approx(2.0 * one)
    model = replace(problem.model, axes=("x", "y"))
    pieces = tuple(Piece(np.zeros((COUNT, 2)), np.zeros((COUNT, 2))) for _ in range(2))
    two = Problem(model, pieces, 1e-3, "zoh", np.ones(2))
    rows = np.column_stack([line, line])
    assert beyond_own_error(two, np.concatenate([rows, 0.0 * rows]).reshape(-1)) == pytest.approx(2.0 * one)
