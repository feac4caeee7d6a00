# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Pairs of effects found side by side, the tails of a size's prior, and what effects make of the model discrepancy."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from hyst_control.base import parallel
from hyst_control.chain import Chain
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.diagnose.problem.coefficient_prior import scatter_of
from hyst_control.diagnose.problem.problem import Piece, Problem
from hyst_control.diagnose.search.beam_search import FittedHypothesis
from hyst_control.diagnose.search.candidate import Candidate, Member
from hyst_control.diagnose.search.catalogue import catalogue
from hyst_control.diagnose.search.combinations import OFTEN, closest_combinations, tangents_of_starts
from hyst_control.diagnose.search.fit import Linearized, fit
from hyst_control.model_file import Model

STEP, NOISE, ROWS = 1e-3, 0.01, 2000
TIME = STEP * np.arange(ROWS)
COMMAND = 10.0 * np.sin(2 * np.pi * 3.0 * TIME)[:, None]


def problem_of(measured, **changes) -> Problem:
    """A static plant, whose record is `measured` (N, 1)."""
    model = Model("m", ("x",), {"command": "V", "measurement": "um"}, STEP, Chain((TransferFunction((1.0,), (1.0,)),)), "foh")
    return Problem(model, (Piece(COMMAND, measured),), STEP, "foh", np.array([NOISE]), **changes)


def prepared(problem: Problem) -> tuple[Linearized, list[Member]]:
    return Linearized(problem, scatter_of(problem.model)), catalogue(problem, {})


def pairs_of(linearized: Linearized, members, count: int, starts: int):
    effects = tangents_of_starts(linearized, members, starts)
    return closest_combinations(linearized, effects, effects, count)


def fitted(linearized: Linearized, members, name: str, place: str = "sensor") -> FittedHypothesis:
    candidate = Candidate((next(one for one in members if one.name == name and one.place == place),))
    return FittedHypothesis(candidate, fit(linearized, candidate.unknowns(), candidate.starts()[0]), 0.0)


def test_two_effects_are_found_of_which_neither_leads():
    late = 10.0 * np.sin(2 * np.pi * 3.0 * (TIME - 0.002))[:, None]
    linearized, members = prepared(problem_of(late * (1.0 + 0.05 * TIME[:, None] / TIME[-1])))
    pairs = [set(candidate.names) for candidate, _ in pairs_of(linearized, members, 3, 4)]
    assert any("gain_drift" in pair and pair & {"delay", "sensor_lowpass", "amplifier_lowpass"} for pair in pairs)


def test_the_start_of_a_pair_is_what_it_was_made_with():
    measured = COMMAND * (1.0 + 0.05 * TIME[:, None] / TIME[-1]) + 0.3
    linearized, members = prepared(problem_of(measured))
    straight = next(one for one in members if one.name == "gain_drift" and "tau" in dict(one.fixed) and one.place == "sensor")
    offset = next(one for one in members if one.name == "offset")
    ((candidate, start),) = pairs_of(linearized, [straight, offset], 1, 4)
    values = {one.name: one.values(start[part]) for one, part in zip(candidate.members, candidate.slices(), strict=True)}
    assert values["offset"]["offset"] == pytest.approx(0.3, abs=0.01)
    assert values["gain_drift"]["change"] == pytest.approx(0.05, abs=0.002)  # a straight drift has no end: over the record


def test_of_the_realizations_of_a_pair_the_one_of_fewest_parameters_is_fitted():
    x = COMMAND / 10.0
    bent = COMMAND + 0.2 * (2.5 * x**3 - 1.5 * x) + 0.06 * (1.5 * x**2 - 0.5)  # Legendre polynomials of degree 3 and 2
    noise = NOISE * np.random.default_rng(0).standard_normal(bent.shape)
    linearized, members = prepared(problem_of(bent * (1.0 + 0.03 * TIME[:, None] / TIME[-1]) + noise, beside_error=True))
    ((candidate, start),) = pairs_of(linearized, members, 1, 4)
    assert set(candidate.names) == {"gain_drift", "sensor_nonlinearity"}
    assert len(start) == 3  # two degrees of the bend, and what the gain drifts by


def test_effects_that_do_nearly_the_same_leave_room_for_others():
    """Low-passes, delays and what follows the level: each would take its place with every partner."""
    late = 9.4 * np.sin(2 * np.pi * 3.0 * (TIME - 0.002))[:, None]
    linearized, members = prepared(problem_of(late))
    pairs = [candidate.names for candidate, _ in pairs_of(linearized, members, 12, 4)]
    counts = Counter(name for names in pairs for name in set(names))
    assert len(pairs) == 12 and max(counts.values()) <= OFTEN
    effects = tangents_of_starts(linearized, members, 4)
    led = closest_combinations(linearized, effects, effects, 12, ["gain"])
    assert sum("gain" in candidate.names for candidate, _ in led) > OFTEN


def test_one_pair_is_listed_once_and_effects_that_exclude_each_other_never():
    linearized, members = prepared(problem_of(1.02 * COMMAND))
    found = [frozenset(member.variant for member in candidate.members) for candidate, _ in pairs_of(linearized, members, 1000, 2)]
    assert len(found) == len(set(found)) and all(len(pair) == 2 for pair in found)


def test_a_size_far_beyond_the_usual_one_is_kept_where_samples_count_little():
    # The model discrepancy makes all samples together worth a few: a normal prior would draw the gain far toward 0.
    problem = problem_of(1.9 * COMMAND, beside_error=True, own_error=np.array([1.0]), own_correlation=30.0)
    linearized, members = prepared(problem)
    assert ROWS * problem.weight < 0.01
    found = fitted(linearized, members, "gain")
    assert found.candidate is not None
    gain = found.candidate.members[0].values(found.solution.x)["gain"]
    information = float(problem.weight * np.sum((0.1 * linearized.nominal) ** 2))  # of the gain, in usual deviations of 0.1
    normal = 0.9 * information / (1.0 + information)
    assert 0.9 - gain < 0.25 * (0.9 - normal)


def test_pairs_are_the_same_on_any_number_of_cores(monkeypatch):
    """Effects hold functions that no process can send back to another one."""
    linearized, members = prepared(problem_of(1.02 * COMMAND + 0.3))
    found = []
    for count in (1, 2):
        monkeypatch.setattr(parallel, "_serial", False)
        monkeypatch.setattr(parallel, "cores", lambda count=count: count)
        found.append([(candidate.names, start.tolist()) for candidate, start in pairs_of(linearized, members, 3, 2)])
    assert found[0] == found[1] and len(found[0]) == 3
