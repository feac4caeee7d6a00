# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The columns of effects that only add to the output, against difference quotients of what they add."""

from __future__ import annotations

import numpy as np
import pytest

from evaluation.blind_test.case import Case
from evaluation.blind_test.case_records import record_of, run_case
from evaluation.blind_test.nominal_models import nominal
from hyst_control.diagnose.problem.problem import split
from hyst_control.diagnose.run.diagnosis import problem_of
from hyst_control.diagnose.search.candidate import Candidate
from hyst_control.diagnose.search.catalogue import catalogue


@pytest.mark.parametrize("names", [("vibration",), ("mains_hum",), ("vibration", "gain"), ("cross_coupling", "vibration")])
def test_columns_of_what_is_added_are_its_derivatives(names):
    case = Case("case", "fsm_published", "none", "rich", 5e-4, 3, ())
    problem, _ = problem_of([record_of(case, run_case(case))], nominal("fsm_published", 5e-4))
    problem = split(problem)[0]
    members = catalogue(problem, {"vibration": [123.4], "mains_hum": [50.0]})
    candidate = Candidate(tuple(next(member for member in members if member.name == name) for name in names))
    unknowns = candidate.unknowns()
    x = np.random.default_rng(1).normal(size=len(unknowns.lower)) * 0.1
    which, columns = unknowns.known_columns(x)
    assert len(which) == sum(member.size for member in candidate.members if member.is_extra) == columns.shape[1]
    for p, column in zip(which, columns.T, strict=True):
        ahead, behind = (unknowns.extra(x + sign * 1e-4 * np.eye(len(x))[p]) for sign in (1, -1))
        quotient = (ahead - behind) / 2e-4
        assert np.abs(column - quotient).max() <= 0.02 * np.abs(quotient).max() + 1e-9
