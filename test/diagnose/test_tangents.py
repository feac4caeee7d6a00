# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Effects to first order: products against a covariance written out, steps against fits, and sums of rows that keep both."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hyst_control.diagnose.configuration import CONFIGURATION
from hyst_control.diagnose.search import tangents as module
from hyst_control.diagnose.search.candidate import Candidate
from hyst_control.diagnose.search.fit import Linearized, fit
from hyst_control.diagnose.search.starts import begin_alone, promising_pairs
from hyst_control.diagnose.search.tangents import tangents_of
from test.diagnose.test_null_key import linearized, members


def with_gap(gain: float = 0.0, offset: float = 0.0, tolerance: float = 1e-4) -> Linearized:
    """A record of a plant of another gain, and of an offset (um)."""
    here = linearized(tolerance=tolerance)
    (piece,) = here.problem.pieces
    changed = replace(piece, measurement=(1.0 + gain) * piece.measurement + offset)
    return Linearized(replace(here.problem, pieces=(changed,)), here.scatter)


def test_products_are_those_under_the_covariance_of_a_record():
    here = with_gap(0.05, tolerance=0.1)
    known = tangents_of(here, members(here))
    covariance = np.eye(len(here.measured)) + here.problem.weight * here.columns @ here.columns.T
    gap = here.measured - here.nominal
    energy, right = known.toward(gap)
    assert energy == pytest.approx(gap @ np.linalg.solve(covariance, gap), rel=1e-8)
    assert known.energy == pytest.approx(energy, rel=1e-8)
    for one, products in zip(known.every, right, strict=True):
        solved = np.linalg.solve(covariance, one.signals)
        np.testing.assert_allclose(one.products, one.signals.T @ solved, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(known.products(one.signals), one.products, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(products, solved.T @ gap, rtol=1e-6, atol=1e-6)
        np.testing.assert_allclose(one.right, products, rtol=1e-6, atol=1e-6)


def test_the_step_of_what_the_output_is_linear_in_is_its_fit():
    here = with_gap(offset=0.02)
    known = tangents_of(here, [member for member in members(here) if member.name == "offset"])
    for one in known.every:
        left, there = one.step(one.right, known.energy, here.problem.weight)
        found = fit(here, Candidate((one.member,)).unknowns(), one.start, rounds=20, linear=True)
        assert there == pytest.approx(found.x, abs=1e-3)
        assert left == pytest.approx(found.misfit, abs=0.5)


def test_what_promises_nothing_is_not_fitted():
    here = with_gap(0.2)
    candidates = members(here)
    known, runs, simulate = tangents_of(here, candidates), [], here.simulate
    here.simulate = lambda *arguments: (runs.append(1), simulate(*arguments))[1]  # type: ignore[method-assign]
    begun = begin_alone(known, 10.0, CONFIGURATION.search)
    assert begun[0].candidate.names == ("gain",) and len(begun) == len(candidates)
    fits = {one.candidate.names[0]: one.misfit for one in begun}
    assert fits["offset"] == pytest.approx(known.nominal_misfit, rel=0.1)  # where its step leads, or its start
    runs.clear()
    begin_alone(known, 1e9, CONFIGURATION.search)
    assert len(runs) <= len(candidates)


def test_an_effect_is_added_that_takes_up_what_another_leaves():
    here = with_gap(0.2, 0.1)
    known = tangents_of(here, members(here))
    own = next(one for one in known.members if one.name == "gain" and not one.elsewhere)
    unknowns = Candidate((own,)).unknowns()
    alone = fit(here, unknowns, own.starts()[0], linear=True)
    found = promising_pairs(known, Candidate((own,)), alone, 5.0, 3)
    place, start = found[0]
    assert known.members[place].name == "offset"
    assert known.members[place].values(start)["offset"] == pytest.approx(0.1, rel=0.3)


def test_sums_of_rows_keep_what_is_collinear_and_products_about(monkeypatch):
    here = with_gap(0.2, tolerance=0.3)
    exact = tangents_of(here, members(here))
    monkeypatch.setattr(module, "MAX_VALUES", 2 * len(here.measured))
    known = tangents_of(here, members(here))
    assert known.together > 1 and len(known.every[0].signals) < len(here.measured)
    for one, whole in zip(known.every, exact.every, strict=True):
        assert one.products == pytest.approx(whole.products)
    twice = 2.0 * here.columns[:, 0] - here.columns[:, 1]
    energy, _ = known.toward(twice)
    plain, _ = exact.toward(twice)
    assert energy < 3.0 * plain < 1e-3 * float(twice @ twice)  # the coefficients take up nearly all of it, summed up or not
    noise = np.random.default_rng(1).standard_normal(60_000)
    assert np.sum(module.summed(noise, 4) ** 2) == pytest.approx(noise @ noise, rel=0.05)
