# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The search for G's parameters, and what a record's drift may be."""

import numpy as np
import pytest

from hyst_control.identify.data.fit_windows import largest_drift, whole_records
from hyst_control.identify.play import hammerstein
from hyst_control.identify.solve.stable_dynamics import Structure
from hyst_control.identify.solve.variable_projection import Problem, solve
from hyst_control.records.excitation import excitation
from hyst_control.records.record import sampled_record
from hyst_plant_sim.physics import load_plant


def test_the_search_ends_at_one_optimum_wherever_it_begins():
    """Weights at their bounds, as here, must not bend the step of G's parameters: each start then ended at a cost of its own."""
    command = excitation.build({"signal": "hampi_identification", "peak": 140.0, "quasi_static": 4.0, "time": 0.03}, 5e-5)
    plant = load_plant({"plant": "pea"}, seed=3, sample_time=5e-5)
    measurement = np.concatenate([plant.reset(command[0])[None], plant.step(command)[:-1]])
    data = sampled_record("r", command, measurement, 5e-5, ("x",), "um", start="settled")
    operators = hammerstein.default_operators(whole_records([data], 0), hammerstein.OperatorOptions(), dynamic=True)
    problem = Problem(whole_records([data], 0), operators, "offset", 1, float(np.ptp(measurement)) / 140.0)
    structure = Structure(modes=1, slow_pair=True)
    costs = [solve(problem, structure, structure.start(frequency), passes=25).fitted for frequency in (500.0, 1000.0, 2000.0)]
    assert max(costs) < 1.01 * min(costs)


def test_a_drift_is_what_the_rests_show_and_no_more():
    """Loops whose mean rises with their frequency, then a true drift of 0.3 on top: the bound follows the drift alone."""
    loops = [excitation.loops(1e-3, frequency, 100.0, 4) for frequency in (2.0, 4.0, 8.0, 16.0)]
    command = np.concatenate([np.concatenate([loop, np.zeros(300)]) for loop in loops])[:, None]
    slopes = np.concatenate([np.full(len(loop) + 300, 0.1 + 0.05 * i) for i, loop in enumerate(loops)])[:, None]
    share = np.linspace(0.0, 1.0, len(command))[:, None]
    for drift in (0.0, 0.3):
        data = sampled_record("r", command, slopes * command + drift * share, 1e-3, ("x",), "um", start="settled")
        assert largest_drift(data, 0) == pytest.approx(drift, rel=0.05, abs=1e-9)
    assert largest_drift(sampled_record("r", command[:1500], command[:1500], 1e-3, ("x",), "um", start="settled"), 0) == np.inf
