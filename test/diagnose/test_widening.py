# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Effects that make the gap larger as given: the coefficients make up for them, and they are no explanation."""

from __future__ import annotations

from dataclasses import replace

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
from hyst_control.diagnose.validate.cross_validation import widens
from hyst_control.model_file import Model

STEP, NOISE = 1e-3, 0.01
COMMAND = 10.0 * np.sin(2 * np.pi * 3.0 * STEP * np.arange(2000))[:, None]
TOLERANCE = 0.1


@pytest.mark.parametrize(
    "measured, gain, tolerances, expected",
    [
        (1.1, 0.1, 0.0, False),  # the gap is the gain
        (1.1, -0.3, 5.7, True),  # a coefficient takes up a gain of -30 %, which leaves a gap of 40 %
        (1.1, -0.03, 1.34, True),  # 13 % in place of 10 %
        (1.1, 0.17, -0.6, False),  # -7 % in place of 10 %
    ],
)
def test_a_gain_that_a_coefficient_makes_up_for_is_none(measured: float, gain: float, tolerances: float, expected: bool) -> None:
    """A static plant of one coefficient: with the gain as given the gap is |measured - 1 - gain| of the command."""
    model = Model(
        "m", ("x",), {"command": "V", "measurement": "um"}, STEP, Chain((TransferFunction((1.0,), (1.0,)),)), "foh",
        tolerance={"num": TOLERANCE},
    )  # fmt: skip
    noise = NOISE * np.random.default_rng(1).standard_normal(COMMAND.shape)
    problem = Problem(model, (Piece(COMMAND, measured * COMMAND + noise),), STEP, "foh", np.array([NOISE]))
    linearized = Linearized(problem, scatter_of(model))
    candidate = Candidate((next(one for one in catalogue(problem, {}) if one.name == "gain" and one.place == "sensor"),))
    ended = fit(linearized, candidate.unknowns(), candidate.starts()[0])
    size = gain / candidate.members[0].parameters[0].scale
    named = FittedHypothesis(candidate, replace(ended, x=np.array([size]), z=np.array([tolerances])), 0.0)
    none = FittedHypothesis(None, replace(ended, x=np.zeros(0), z=np.zeros(1)), 0.0)
    assert widens(linearized, named, none) == expected
