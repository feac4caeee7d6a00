# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""What the MHL experiment's tables say of made-up signals whose answer is known."""

import numpy as np
import pytest

from evaluation.reproduction.mhl import RATE_FILTER, tracking_reference
from evaluation.reproduction.mhl_runs import REACH, SAMPLE_TIME
from evaluation.reproduction.mhl_tables import AHEAD, OWN_LOOP, PLAIN, TRADITIONAL, rival_of
from evaluation.reproduction.papers import MHL


@pytest.mark.parametrize("name", ["single", "decreasing", "multi"])
def test_references_start_and_end_without_a_kink_in_velocity(name):
    """No velocity changes by more from one sample to the next than in the sine of 100 Hz itself, from 200 samples before to 600 after."""
    reference, parts = tracking_reference()
    turn = np.abs(np.diff(reference[parts[name].begin - 200 : parts[name].end + 600, 0], 2)).max()
    assert turn <= 1.1 * REACH * (2 * np.pi * 100.0 * SAMPLE_TIME) ** 2


def test_a_composite_is_held_against_the_traditional_one_with_its_own_feedback():
    assert [rival_of(name) for name in (AHEAD, OWN_LOOP)] == [TRADITIONAL, TRADITIONAL + PLAIN]


def test_the_printed_lead_and_filter_fit_another_mirror_than_the_printed_model():
    """At 100 Hz 1 + N Ψ' of Tables 1, 2 and §4.4 undoes 0.86 at -6.3 degrees behind H_S^-1, whatever the gains of the feedback."""
    s = 2j * np.pi * 100.0
    lead = MHL.published["table_2"]["k1'"] * s / (MHL.published["table_2"]["k2'"] * s + 1.0) / np.polyval(RATE_FILTER, s)
    wanted = 1.0 / (1.0 + lead)
    assert abs(wanted) == pytest.approx(0.86, abs=0.005)
    assert np.degrees(np.angle(wanted)) == pytest.approx(-6.3, abs=0.05)
    assert -np.degrees(np.angle(1.0 / np.polyval(RATE_FILTER, s))) == pytest.approx(33.2, abs=0.1)
