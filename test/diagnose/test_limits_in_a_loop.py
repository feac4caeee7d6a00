# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A loop drives the command far beyond a driver that clips: the limit may lie anywhere in the range of the command."""

from __future__ import annotations

import numpy as np
import pytest

from evaluation.blind_test.case import Case
from evaluation.blind_test.case_records import record_of, run_case
from evaluation.blind_test.nominal_models import nominal
from hyst_control.diagnose.run.diagnosis import problem_of
from hyst_control.diagnose.search.catalogue import catalogue
from hyst_control.diagnose.search.fit import TAIL
from hyst_control.diagnose.workflow import diagnosed
from test.diagnose.conftest import all_but


@pytest.mark.parametrize(("end", "limit"), [("upper", 11.7), ("upper", 22.5), ("lower", 30.0)])
def test_a_limit_far_inside_the_command_that_a_loop_asks_for_is_named(end, limit):
    case = Case("case", "pea_published", "single", "closed_loop", 5e-4, 203, ({"name": "saturation", end: limit},))
    without = all_but("saturation", "output_saturation", "gain", "dead_zone", "hysteresis_shape")
    document, _, _ = diagnosed([record_of(case, run_case(case))], nominal("pea_published", 5e-4), without=without, cache=False)
    assert [one["name"] for one in document["effects"]] == ["saturation"]
    assert document["effects"][0]["parameters"][end]["value"] == pytest.approx(limit, abs=0.1)


def test_a_limit_is_about_as_probable_anywhere_in_the_range_of_the_command():
    case = Case("case", "pea_published", "none", "rich", 5e-4, 1, (), duration=0.5)
    problem, _ = problem_of([record_of(case, run_case(case))], nominal("pea_published", 5e-4))
    low, high = problem.surroundings.command
    member = next(one for one in catalogue(problem, {}) if one.name == "saturation" and one.size == 2)
    for parameter, centre in zip(member.parameters, member.bounds()[2], strict=True):
        away = np.linspace(low, high, 11) / parameter.scale - centre
        density = -0.5 * TAIL**2 * np.log1p((away / TAIL) ** 2) - np.log(np.sqrt(2.0 * np.pi) * parameter.scale)
        assert density.max() <= -np.log(high - low) + 1e-9 and density.min() > -np.log(high - low) - 2.5
