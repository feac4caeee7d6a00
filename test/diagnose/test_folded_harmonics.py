# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The mains' harmonics on a record whose sampling folds them onto the mains themselves: sums of sines with added noise."""

from __future__ import annotations

import numpy as np
import pytest

from hyst_control.chain import Chain
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.diagnose.problem.coefficient_prior import scatter_of
from hyst_control.diagnose.problem.problem import Piece, Problem
from hyst_control.diagnose.search.candidate import Candidate
from hyst_control.diagnose.search.catalogue import catalogue
from hyst_control.diagnose.search.fit import Linearized, fit
from hyst_control.model_file import Model

STEP, NOISE, AMPLITUDE = 5e-3, 0.05, 0.5
TIME = STEP * np.arange(1200)
COMMAND = (50.0 + 20.0 * np.sin(2 * np.pi * TIME))[:, None]


@pytest.mark.parametrize(("third", "within"), [(0.0, 0.06), (0.3, 0.35)])
def test_the_fundamental_is_the_largest(third, within):
    """150, 250 and 350 Hz look like 50 Hz at 200 Hz: shared out evenly, a quarter of the hum would be the fundamental's."""
    model = Model("m", ("x",), {"command": "V", "measurement": "um"}, STEP, Chain([TransferFunction((1.0,), (0.05, 1.0))]), "foh")
    blank = Problem(model, (Piece(COMMAND, np.zeros_like(COMMAND)),), STEP, "foh", np.ones(1))
    angle = 2 * np.pi * 50.0 * TIME + 0.4
    hum = AMPLITUDE * (np.sin(angle) + third * np.sin(3.0 * angle))
    noise = NOISE * np.random.default_rng(1).standard_normal(len(TIME))
    measured = blank.simulate(model.chain.stages) + hum + noise
    problem = Problem(model, (Piece(COMMAND, measured[:, None]),), STEP, "foh", np.array([NOISE]))
    member = next(one for one in catalogue(problem, {"mains_hum": [50.0]}) if one.name == "mains_hum")
    unknowns = Candidate((member,)).unknowns()
    found = fit(Linearized(problem, scatter_of(model)), unknowns, np.zeros(member.size))
    assert member.values(found.x)["amplitude"] == pytest.approx(AMPLITUDE, rel=within)
    assert found.residual @ found.residual < 1.2 * len(TIME)
