# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A size at the end of the catalogue's range is not known, whichever of an effect's sizes it is."""

from __future__ import annotations

import numpy as np
import pytest

from evaluation.blind_test.case import Case
from evaluation.blind_test.case_records import record_of, run_case
from evaluation.blind_test.nominal_models import nominal
from hyst_control.diagnose.run.diagnosis import problem_of
from hyst_control.diagnose.search.candidate import Candidate
from hyst_control.diagnose.search.catalogue import catalogue


@pytest.fixture(scope="module")
def members():
    case = Case("case", "pea_published", "none", "sine", 5e-4, 3, ())
    problem, _ = problem_of([record_of(case, run_case(case))], nominal("pea_published", 5e-4))
    return catalogue(problem, {})


@pytest.mark.parametrize(
    "name, parameter, end",
    [
        ("hysteresis_shape", "even", True),
        ("hysteresis_shape", "odd", True),
        ("hysteresis_shape", "tilt", True),
        ("sensor_nonlinearity", "third", True),
        ("sensor_nonlinearity", "ratio", False),  # of a bend, which is small
        ("resonance", "gain", True),
        ("resonance", "quadrature", False),
        ("gain", "gain", True),
        ("creep", "decades", False),  # how long it goes on no record tells
    ],
)
def test_every_size_counts_and_no_other_parameter(members, name, parameter, end):
    member = next(one for one in members if one.name == name and any(p.name == parameter for p in one.parameters))
    index = [p.name for p in member.parameters].index(parameter)
    (lower, upper, _), start = member.bounds(), member.starts()[-1]
    for bound in (lower, upper):
        x = np.where(np.arange(len(start)) == index, bound, start)
        within = np.where(np.arange(len(start)) == index, 0.5 * bound, start)
        other = next(one for one in members if one.name == "delay")
        pair = Candidate((other, member))
        assert member.is_at_bound(x) == pair.is_at_bound(np.concatenate([other.starts()[0], x])) == end
        assert not member.is_at_bound(within)
