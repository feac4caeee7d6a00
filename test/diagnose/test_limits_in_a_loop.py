# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A loop drives the command far beyond a driver that clips: the limit may lie anywhere in the range of the command."""

from __future__ import annotations

import pytest

from evaluation.blind_test.case import Case
from evaluation.blind_test.case_records import record_of, run_case
from evaluation.blind_test.nominal_models import nominal
from hyst_control.diagnose.workflow import diagnosed
from test.diagnose.conftest import all_but


@pytest.mark.parametrize(("end", "limit"), [("upper", 11.7), ("upper", 22.5), ("lower", 30.0)])
def test_a_limit_far_inside_the_command_that_a_loop_asks_for_is_named(end, limit):
    case = Case("case", "pea_published", "single", "closed_loop", 5e-4, 203, ({"name": "saturation", end: limit},))
    without = all_but("saturation", "output_saturation", "gain", "dead_zone", "hysteresis_shape")
    document, _, _ = diagnosed([record_of(case, run_case(case))], nominal("pea_published", 5e-4), without=without, cache=False)
    assert [one["name"] for one in document["effects"]] == ["saturation"]
    assert document["effects"][0]["parameters"][end]["value"] == pytest.approx(limit, abs=0.1)
