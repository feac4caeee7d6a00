# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A gap within the model's tolerances is one to act on where the simulation as given is far off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import hyst_control as hc
from hyst_control.chain import Chain
from hyst_control.chain.memoryless import Gain, Offset
from hyst_control.diagnose.configuration import CONFIGURATION
from hyst_control.diagnose.problem.coefficient_prior import scatter_of
from hyst_control.diagnose.run.collect import companions
from hyst_control.diagnose.run.diagnosis import with_clean
from hyst_control.diagnose.search.beam_search import FittedHypothesis
from hyst_control.diagnose.search.candidate import Candidate
from hyst_control.diagnose.search.fit import Linearized, fit
from hyst_control.diagnose.workflow import diagnosed
from hyst_control.model_file import Model, simulate
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


@pytest.mark.parametrize("zero", [0.0, 0.4])
def test_a_zero_that_a_coefficient_may_move_is_counted_once(zero):
    """The model's offset has a wide tolerance, and so has the session: however they share a zero, it is one, and no change."""
    time = 1e-3 * np.arange(4000)
    command = 50.0 + 40.0 * np.sin(11.0 * time) + 5.0 * np.sin(47.0 * time)
    stages = (Gain(0.1), Offset(0.3))
    units, stated = {"command": "V", "measurement": "um"}, {"rms": [1e-3], "correlation": 0.05}
    model = Model(
        "biased", ("x",), units, 1e-3, Chain(stages), noise={"sigma": 1e-3}, tolerance={"offset": 5.0}, discrepancy=stated
    )
    measured = simulate(model, command[:, None])[:, 0] + zero + 1e-3 * np.random.default_rng(3).standard_normal(4000)
    record = hc.from_arrays(command, measured, rate=1000.0, hold="zoh")
    _, _, _, ((problem, baseline, _),) = with_clean([record], model, 0.0, CONFIGURATION, ())
    linearized = Linearized(baseline.problem, scatter_of(baseline.problem.model))
    none = FittedHypothesis(Candidate(()), fit(linearized), 0.0)
    session = linearized.scatter.companions > 0.0
    assert abs(none.solution.z[~session][0]) > 0.05 * zero  # the offset has a part of it
    found = {one.effect: one.value for one in companions(linearized, none, np.full((1, 3), 0.1), 1.0)}
    assert found["offset"] == pytest.approx(zero, abs=1e-3) and found["offset_drift"] == pytest.approx(0.0, abs=2e-3)
