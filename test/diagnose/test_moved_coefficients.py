# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A gap within the model's tolerances is one to act on where the simulation as given is far off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hyst_control.diagnose.workflow import diagnosed
from test.diagnose.conftest import all_but, nominal, record_of


@pytest.mark.parametrize(
    "factor, verdict, reason", [(0.94, "parameters", "coefficients_within_tolerance"), (0.985, "no_gap", "below_null")]
)
def test_a_gain_within_wide_tolerances_is_told_by_what_it_does_to_the_output(factor, verdict, reason):
    """Six per cent less are 3.6 % of the range here, and a user has to act on that; one and a half are the scatter of units."""
    record = record_of("pea_published", [])
    measured = record.signal("measurement")
    scaled = replace(measured, values=factor * measured.values)
    model = replace(nominal("pea_published"), tolerance={"num": 0.08, "k": 0.02, "b": 0.02})
    off = (1.0 - factor) * np.sqrt(np.mean(measured.values**2)) / np.ptp(scaled.values)
    document, diagnosis, _ = diagnosed(
        [replace(record, signals={**record.signals, "measurement": scaled})], model, without=all_but("gain", "delay")
    )
    assert (document["verdict"], document["reasons"]) == (verdict, [reason])
    assert diagnosis.parts[0].evidence.moved == pytest.approx(off, rel=0.1)
