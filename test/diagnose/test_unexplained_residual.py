# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""What an explanation's own effects leave by nature is no sign of another effect."""

from __future__ import annotations

import numpy as np
import pytest

from hyst_control.chain import Chain
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.diagnose.problem.coefficient_prior import scatter_of
from hyst_control.diagnose.problem.problem import Piece, Problem
from hyst_control.diagnose.search.beam_search import FittedHypothesis
from hyst_control.diagnose.search.candidate import Candidate
from hyst_control.diagnose.search.catalogue import catalogue
from hyst_control.diagnose.search.fit import Linearized, fit
from hyst_control.diagnose.validate.unexplained_residual import leftover
from hyst_control.model_file import Model

STEP, NOISE, SHAKEN = 1e-3, 0.01, 60.0
TIME = STEP * np.arange(8000)
COMMAND = 10.0 * np.sin(2 * np.pi * 3.0 * TIME)[:, None]


@pytest.mark.parametrize("number", [0, 1])
@pytest.mark.parametrize(("multiple", "own"), [(2.0, True), (3.0, True), (2.5, False)])
def test_overtones_of_a_wandering_vibration_are_its_own(multiple, own, number):
    """A shaker whose phase wanders, with a second line: at a multiple of its frequency it is its own, elsewhere it is not."""
    random = np.random.default_rng(1)
    phase = np.cumsum(np.full(len(TIME), 2 * np.pi * SHAKEN * STEP) + 0.01 * random.standard_normal(len(TIME)))
    shaken = 0.2 * (np.sin(phase) + 0.4 * np.sin(multiple * phase))
    measured = COMMAND + (shaken + NOISE * random.standard_normal(len(TIME)))[:, None]
    model = Model("m", ("x",), {"command": "V", "measurement": "um"}, STEP, Chain((TransferFunction((1.0,), (1.0,)),)), "foh")
    problem = Problem(model, (Piece(COMMAND, measured),), STEP, "foh", np.array([NOISE]))
    linearized = Linearized(problem, scatter_of(model))
    members = [
        one for one in catalogue(problem, {"vibration": [SHAKEN]}) if one.name == "vibration" and len(one.line.harmonics) == 1
    ]
    candidate = Candidate((members[number],))
    solution = fit(linearized, candidate.unknowns(), candidate.starts()[0])
    energy = float(np.mean(leftover(problem, FittedHypothesis(candidate, solution, 0.0), np.zeros(1)) ** 2))
    second = 0.5 * (0.2 * 0.4 / NOISE) ** 2
    assert energy < 0.1 * second if own else energy > 0.8 * second
