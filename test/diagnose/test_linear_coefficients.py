# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Fits beside linear coefficients, against scipy's, and how they lead to those of the chain as it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from hyst_control.chain import Chain
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.diagnose.configuration import CONFIGURATION
from hyst_control.diagnose.problem.coefficient_prior import scatter_of
from hyst_control.diagnose.problem.problem import Piece, Problem
from hyst_control.diagnose.search import beam_search
from hyst_control.diagnose.search.beam_search import search
from hyst_control.diagnose.search.candidate import Candidate
from hyst_control.diagnose.search.catalogue import catalogue
from hyst_control.diagnose.search.fit import TAIL, Linearized, fit, refined
from hyst_control.diagnose.search.starts import Begun, begin, gone_on, misfit_of
from hyst_control.effects.added_mass import AddedMass
from hyst_control.effects.slew_limit import SlewLimit
from hyst_control.model_file import Model

STEP, NOISE, ROWS = 1e-4, 0.002, 4000
TIME = STEP * np.arange(ROWS)
COMMAND = (50.0 + 20.0 * np.sin(2 * np.pi * 20.0 * TIME) + 10.0 * np.sin(2 * np.pi * 130.0 * TIME))[:, None]
PLANT = TransferFunction((1.0,), (1.0 / (2 * np.pi * 400.0) ** 2, 0.2 / (2 * np.pi * 400.0), 1.0))


def model_of(*stages) -> Model:
    tolerance = {"den": 0.05}
    return Model("m", ("x",), {"command": "V", "measurement": "um"}, STEP, Chain(stages), "foh", tolerance=tolerance)


def linearised_of(*truth) -> Linearized:
    """The plant's model on a record of the plant behind these stages as well, in noise."""
    blank = Problem(model_of(*truth), (Piece(COMMAND, np.zeros((ROWS, 1))),), STEP, "foh", np.ones(1))
    measured = blank.simulate(blank.model.chain.stages)[:, None]
    measured = measured + NOISE * np.random.default_rng(1).standard_normal(measured.shape)
    problem = Problem(model_of(PLANT), (Piece(COMMAND, measured),), STEP, "foh", np.array([NOISE]))
    found = Linearized(problem, scatter_of(problem.model))
    assert found.count == 3
    return found


LAG = TransferFunction((1.0,), (1.0 / (2 * np.pi * 900.0), 1.0))


@pytest.fixture
def simulations(monkeypatch) -> list[int]:
    """A list that has an item for every simulation."""
    usual, seen = Linearized.simulate, list[int]()
    monkeypatch.setattr(Linearized, "simulate", lambda *given: seen.append(1) or usual(*given))
    return seen


def candidate_of(linearized: Linearized, name: str) -> Candidate:
    return Candidate((next(one for one in catalogue(linearized.problem, {}) if one.name == name),))


def test_it_ends_where_a_fit_of_scipy_does():
    linearized = linearised_of(PLANT, LAG)
    unknowns = candidate_of(linearized, "sensor_lowpass").unknowns()
    found = fit(linearized, unknowns, unknowns.centre, linear=True)
    nominal = np.zeros(linearized.count)

    def rows(v):
        z, x = v[: linearized.count], v[linearized.count :]
        rest = linearized.measured - linearized.simulate(nominal, unknowns, x) - linearized.columns @ z
        away = (x - unknowns.centre) / TAIL
        return np.concatenate([rest, z, TAIL * np.sqrt(np.log1p(away**2))])

    start = np.concatenate([nominal, unknowns.centre])
    low = np.concatenate([np.full(linearized.count, -np.inf), unknowns.lower])
    high = np.concatenate([np.full(linearized.count, np.inf), unknowns.upper])
    independent = least_squares(rows, start, bounds=(low, high), x_scale="jac")
    # The fit stops where a step would gain less than a nat.
    assert independent.cost - 1e-6 < found.misfit < independent.cost + 1.0 + 1e-3 * independent.cost
    assert found.x == pytest.approx(independent.x[linearized.count :], abs=0.02)
    assert found.z == pytest.approx(independent.x[: linearized.count], abs=0.05)


def test_products_are_those_of_what_a_shrunk_least_squares_fit_leaves():
    linearized = linearised_of(PLANT, LAG)
    vectors = np.random.default_rng(2).standard_normal((ROWS, 3)) + linearized.columns[:, :3]
    weight = np.sqrt(linearized.problem.weight)
    # The coefficients' prior as rows of its own: a plain least-squares problem.
    rows = np.vstack([weight * linearized.columns, np.eye(linearized.count)])
    padded = np.vstack([weight * vectors, np.zeros((linearized.count, 3))])
    left = padded - rows @ np.linalg.lstsq(rows, padded, rcond=None)[0]
    assert linearized.unexplained_products(vectors) == pytest.approx(left.T @ left / weight**2, rel=1e-9, abs=1e-6)


def test_where_nothing_else_scatters_it_is_the_fit_of_the_chain():
    linearized = linearised_of(PLANT, LAG)
    model = replace(linearized.problem.model, tolerance={})
    fixed = Linearized(replace(linearized.problem, model=model), scatter_of(model))
    unknowns = candidate_of(fixed, "sensor_lowpass").unknowns()
    one, other = (fit(fixed, unknowns, unknowns.centre, linear=way) for way in (True, False))
    assert one.x == pytest.approx(other.x, abs=1e-3)
    assert one.misfit == pytest.approx(other.misfit, abs=1.0)


def test_the_truth_leads_and_its_fit_of_the_chain_leaves_the_noise():
    linearized = linearised_of(PLANT, LAG)
    names = ("sensor_lowpass", "delay", "gain", "offset")
    candidates = [candidate_of(linearized, name) for name in names]
    begun = begin(linearized, [(one, one.starts()) for one in candidates], CONFIGURATION.search)
    assert begun[0].candidate.names == ("sensor_lowpass",)
    assert [one.misfit for one in begun] == sorted(one.misfit for one in begun)
    solution = gone_on(linearized, begun[0], np.inf)
    assert 2.0 * solution.misfit / ROWS == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(("truth", "name"), [((PLANT, LAG), "sensor_lowpass"), ((PLANT, AddedMass(0.4)), "sensor_lowpass")])
def test_what_a_step_leaves_to_be_gained_is_not_underestimated(truth, name):
    linearized = linearised_of(*truth)
    unknowns = candidate_of(linearized, name).unknowns()
    for start in np.linspace(unknowns.lower, unknowns.upper, 9)[1:-1]:
        one = fit(linearized, unknowns, start, rounds=1, linear=True)
        end = fit(linearized, unknowns, one.x, linear=True)
        assert one.misfit - end.misfit <= max(one.remaining, 5.0), start


def test_a_step_of_an_effect_that_is_linear_leaves_nothing_to_be_gained(simulations):
    linearized = linearised_of(PLANT)
    unknowns = candidate_of(linearized, "offset").unknowns()
    simulations.clear()
    one = fit(linearized, unknowns, unknowns.upper, rounds=1, linear=True)
    assert one.remaining == 0.0 and len(simulations) == 3  # the start, its column and the end


def test_effects_far_behind_the_best_ones_are_not_fitted_to_the_end(monkeypatch, simulations):
    linearized = linearised_of(PLANT, LAG)
    candidates = [Candidate((one,)) for one in catalogue(linearized.problem, {}) if 0 < one.size < 4 and not one.is_suggested]
    started = [(one, one.starts()) for one in candidates]
    without = misfit_of(linearized, linearized.measured - linearized.nominal)

    def found(share: float) -> tuple[list[Begun], int]:
        monkeypatch.setattr("hyst_control.diagnose.search.starts.MIN_APPROACH", share)
        monkeypatch.setattr("hyst_control.diagnose.search.fit.MIN_APPROACH", share)
        simulations.clear()
        return begin(linearized, started, replace(CONFIGURATION.search, first=2), without), len(simulations)

    (early, few), (late, many) = found(0.25), found(0.0)
    assert early[0].candidate is late[0].candidate and early[0].misfit == late[0].misfit
    assert few < many


@pytest.mark.parametrize(("limit", "expected"), [(9000.0, ["delay", "gain"]), (np.inf, ["delay", "gain", "offset"])])
def test_the_best_fit_is_settled_first_and_then_those_that_may_come_near_it(monkeypatch, limit, expected):
    linearized, seen = linearised_of(PLANT), []
    ends = {"offset": (7000.0, 8000.0), "gain": (2030.0, 9500.0), "delay": (6000.0, 5000.0)}  # linear, and of the chain as it is
    solution = fit(linearized)
    fits = [
        (Begun(candidate_of(linearized, name), (replace(solution, misfit=one),)), replace(solution, misfit=other))
        for name, (one, other) in ends.items()
    ]

    def settled(linearized, candidate, solution, rival, thresholds):
        seen.append((candidate.names[0], rival))
        return replace(solution, misfit=2000.0 if candidate.names == ("delay",) else solution.misfit)

    monkeypatch.setattr(beam_search, "_settled", settled)
    found = beam_search._all_settled(linearized, fits, limit, 10000.0, CONFIGURATION)
    assert {candidate.names[0]: one.misfit for candidate, one in found} == {"delay": 2000.0, "gain": 9500.0, "offset": 8000.0}
    assert seen[0] == ("delay", np.inf) and sorted(name for name, _ in seen) == expected
    assert all(rival == 2000.0 + 0.01 * 8000.0 for _, rival in seen[1:])


def test_a_fit_far_behind_a_better_one_is_not_refined_again(monkeypatch):
    linearized = linearised_of(PLANT, LAG)
    unknowns = candidate_of(linearized, "delay").unknowns()
    begun, made = fit(linearized, unknowns, unknowns.centre), []
    usual = Linearized.__init__
    monkeypatch.setattr(Linearized, "__init__", lambda *given: made.append(1) or usual(*given))
    whole = refined(linearized, unknowns, begun)
    rounds = len(made)
    assert refined(linearized, unknowns, begun, rival=0.01 * whole.misfit).misfit >= whole.misfit
    assert len(made) - rounds <= 2 < rounds


def lag_of_second_order(corner: float) -> TransferFunction:
    w = 2 * np.pi * corner
    return TransferFunction((1.0,), (1.0 / w**2, 1.4 / w, 1.0))


@pytest.mark.parametrize(
    ("name", "truth"),
    [
        *(("sensor_lowpass", (PLANT, lag_of_second_order(corner))) for corner in (150.0, 1000.0, 4000.0)),
        *(("added_mass", (PLANT, AddedMass(share))) for share in (-0.3, 0.02, 0.4, 1.5, 2.5)),
        *(("slew_limit", (SlewLimit(rate), PLANT)) for rate in (2000.0, 7000.0)),
    ],
)
def test_effects_of_two_parameters_are_found_however_large(name, truth):
    linearized = linearised_of(*truth)
    candidates = [Candidate((one,)) for one in catalogue(linearized.problem, {}) if one.name == name]
    begun = begin(linearized, [(one, one.starts()) for one in candidates], CONFIGURATION.search, linearized_misfit(linearized))
    left = min(gone_on(linearized, one, np.inf).misfit for one in begun)
    assert 2.0 * left / ROWS == pytest.approx(1.0, abs=0.1)


def linearized_misfit(linearized: Linearized) -> float:
    return fit(linearized, linear=True).misfit


def test_a_large_effect_alone_needs_no_second_one_for_what_linear_coefficients_leave():
    w = 2 * np.pi * 380.0  # the mode is 5 % slower than the model's
    linearized = linearised_of(TransferFunction((1.0,), (1.0 / w**2, 0.08 / w, 1.0)), LAG)
    members = [one for one in catalogue(linearized.problem, {}) if one.name in ("sensor_lowpass", "gain", "gain_drift", "creep")]
    begun = begin(linearized, [(Candidate((one,)), one.starts()) for one in members], CONFIGURATION.search)
    beyond = 2.0 * begun[0].misfit / ROWS - 1.0
    assert beyond > 0.1  # so much is left beside linear coefficients
    found = search(linearized, members, 10.0, 0.0)
    assert found.singles[0].names == ("sensor_lowpass",)
    assert not found.combinations
    assert 2.0 * found.singles[0].solution.misfit / ROWS == pytest.approx(1.0, abs=0.1)


def test_an_effect_that_does_not_lead_by_its_linear_fit_is_fitted_before_it_gets_a_second_one(monkeypatch):
    linearized = linearised_of(PLANT, LAG)
    members = [candidate_of(linearized, name).members[0] for name in ("sensor_lowpass", "gain", "offset")]

    misfits = {("gain",): 1e6, ("offset",): 1.2e6, ("sensor_lowpass",): 7.813e6}  # no better than what others end at

    def behind(*arguments):
        found = begin(*arguments)
        seen = [(one.ends[0], misfits.get(one.candidate.names, one.misfit), one) for one in found]
        return sorted((replace(one, ends=(replace(end, misfit=of),)) for end, of, one in seen), key=lambda one: one.misfit)

    monkeypatch.setattr("hyst_control.diagnose.search.beam_search.begin", behind)
    found = search(linearized, members, 10.0, 0.0)
    assert found.singles[0].names == ("sensor_lowpass",) and not found.combinations
    assert 2.0 * found.singles[0].solution.misfit / ROWS == pytest.approx(1.0, abs=0.1)


def test_fits_far_behind_another_end_early():
    linearized = linearised_of(PLANT, LAG)
    candidates = [candidate_of(linearized, name) for name in ("creep", "gain_drift", "backlash", "offset")]
    runs: list[int] = []
    simulate = linearized.simulate
    linearized.simulate = lambda *arguments: (runs.append(1), simulate(*arguments))[1]
    counts = []
    for rival in (np.inf, 0.5 * ROWS):
        runs.clear()
        for candidate in candidates:
            end = fit(linearized, candidate.unknowns(), candidate.starts()[0], rival=rival)
            assert end.misfit > 100.0 * ROWS  # none of them is the lag
        counts.append(len(runs))
    assert counts[1] < 0.8 * counts[0]


def test_coefficients_that_the_chain_cannot_follow_are_shortened():
    linearized = linearised_of(PLANT, LAG)
    candidate = candidate_of(linearized, "offset")
    end = fit(linearized, candidate.unknowns(), np.zeros(1), linear=True)
    wild = Begun(candidate, (replace(end, z=np.full(linearized.count, -1e3)),))
    solution = gone_on(linearized, wild, np.inf)
    usual = gone_on(linearized, Begun(candidate, (end,)), np.inf)
    assert np.isfinite(solution.misfit)
    assert solution.misfit < 10.0 * usual.misfit
