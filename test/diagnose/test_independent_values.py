# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Independent values of a model discrepancy: counted by what the coefficients explain of baseline records, and what they make of nats."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hyst_control.chain import Chain
from hyst_control.chain.hysteresis.prandtl_ishlinskii import PrandtlIshlinskii
from hyst_control.diagnose.problem.coefficient_prior import scatter_of
from hyst_control.diagnose.problem.problem import Piece, Problem
from hyst_control.diagnose.search.beam_search import FittedHypothesis, search, weighed
from hyst_control.diagnose.search.catalogue import catalogue
from hyst_control.diagnose.search.fit import Linearized, Solution
from hyst_control.diagnose.validate.present_in_baseline import CleanRecords
from hyst_control.effects import EFFECTS
from hyst_control.identify.model_error.error_spectrum import ErrorSpectrum
from hyst_control.model_file import Model

COUNT = 2048
PLAYS = PrandtlIshlinskii([0.5, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0], [0.5] * 8)
MODEL = Model("a", ("x",), {"command": "V", "measurement": "um"}, 1e-3, Chain((PLAYS,)), tolerance={"weights": 0.5})
"""Eight weights that may be off."""


def spectrum(power: float) -> ErrorSpectrum:
    """A discrepancy of this power per bin up to half of the band, beside white noise of size 1."""
    frequencies = 500.0 * np.arange(COUNT) / COUNT
    return ErrorSpectrum(frequencies, power * (frequencies < 250.0)[:, None].astype(float), np.ones(1))


def problem(error: np.ndarray, power: float = 0.0) -> Problem:
    command = 10.0 * np.sin(2 * np.pi * 3.0 * 1e-3 * np.arange(COUNT))[:, None]
    clean = Problem(MODEL, (Piece(command, command),), 1e-3, "foh", np.ones(1))
    measured = clean.rows(clean.simulate(MODEL.chain.stages)) + error[:, None]
    return replace(clean, pieces=(Piece(command, measured),), own_spectrum=spectrum(power))


def test_noise_has_as_many_independent_values_as_bins():
    random = np.random.default_rng(1)
    found = [1.0 / CleanRecords(problem(random.normal(size=COUNT))).independent for _ in range(200)]
    assert np.median(found) < 1.3  # and at least 1, as the share is limited to 1


@pytest.mark.parametrize("times", [5, 20])
def test_an_error_of_few_values_has_few_of_them(times):
    """Noise that stands for `times` rows: the coefficients, which are slow, explain `times` as much of it as of white noise."""
    random = np.random.default_rng(2)
    held = [np.repeat(random.normal(size=-(-COUNT // times)), times)[:COUNT] for _ in range(60)]
    inverse = np.median([1.0 / CleanRecords(problem(rows)).independent for rows in held])
    assert times / 2 < inverse < 2 * times


def test_nats_count_what_the_discrepancy_dominates_by_its_independent_values():
    """Closed form: bins of discrepancy and noise 99 to 1 by a hundredth and what noise there is, those of noise in full."""
    slow, fast = (np.sqrt(2.0 / COUNT) * np.cos(np.pi * k * (np.arange(COUNT) + 0.5) / COUNT) for k in (100, 1900))
    beside = replace(problem(np.zeros(COUNT), power=99.0), independent=0.01)
    assert beside.nats(slow) == pytest.approx(0.5 * (1.0 - 0.99 * 0.99))
    assert beside.nats(fast) == pytest.approx(0.5)
    assert beside.nats(3.0 * slow + 2.0 * fast) == pytest.approx(9.0 * beside.nats(slow) + 4.0 * beside.nats(fast))
    assert replace(beside, independent=1.0).nats(slow) == pytest.approx(0.5)


def test_a_misfit_counts_the_coefficients_by_the_same_share():
    """Of ½ z² as much as of the bins by which baseline records tell the coefficients."""
    beside = replace(problem(np.zeros(COUNT), power=99.0), independent=0.01)
    residual, z = np.random.default_rng(3).normal(size=COUNT), np.array([3.0, 4.0])
    solution = Solution(0.5 * float(residual @ residual) + 12.5 + 2.0, z, np.zeros(0), residual, np.eye(2), np.zeros((0, 0)))
    scored = FittedHypothesis(None, solution, 0.0, noise=1.5)
    assert weighed(beside, scored) == pytest.approx(beside.nats(residual) + 0.01 * 12.5 + 2.0 - 1.5)


def test_scores_are_of_the_weighed_misfits():
    """Twice the motion beside a slow discrepancy: with a fiftieth of the independent values less than a tenth of the score is left."""
    made = replace(problem(np.random.default_rng(4).normal(size=COUNT), power=99.0), model=replace(MODEL, tolerance={}))
    measured = made.rows(2.0 * made.simulate(made.model.chain.stages))
    made = replace(made, pieces=(replace(made.pieces[0], measurement=measured),))

    def best(independent: float) -> float:
        linearized = Linearized(replace(made, independent=independent), scatter_of(made.model))
        members = catalogue(linearized.problem, {}, [name for name in EFFECTS if name != "gain"])
        return search(linearized, members, 5.0, 0.01).singles[0].score

    assert 0.0 < best(0.02) < 0.1 * best(1.0)
