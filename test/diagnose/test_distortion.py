# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Distortion tests: an effect whose size would have to change with something else."""

from __future__ import annotations

import numpy as np
import pytest

from hyst_control.chain import Chain
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.diagnose.configuration import CONFIGURATION
from hyst_control.diagnose.evidence import DistortionEvidence
from hyst_control.diagnose.problem.coefficient_prior import scatter_of
from hyst_control.diagnose.problem.problem import Piece, Problem
from hyst_control.diagnose.search.beam_search import FittedHypothesis
from hyst_control.diagnose.search.candidate import Candidate
from hyst_control.diagnose.search.catalogue import catalogue
from hyst_control.diagnose.search.fit import Linearized, fit
from hyst_control.diagnose.validate.constancy import distortions
from hyst_control.model_file import Model

STEP, NOISE = 1e-3, 0.01
TIME = STEP * np.arange(4000)
COMMAND = 10.0 * np.sin(2 * np.pi * 3.0 * TIME)[:, None]
LEVEL, RATE = COMMAND / 10.0, np.cos(2 * np.pi * 3.0 * TIME)[:, None]


def distorted(sensor, name: str = "gain", temper: float = 1.0) -> dict[str, DistortionEvidence]:
    """Distortions, by variable, of a gain that is fitted to the record sensor(level, time, direction) of a static plant."""
    model = Model("m", ("x",), {"command": "V", "measurement": "um"}, STEP, Chain((TransferFunction((1.0,), (1.0,)),)), "foh")
    measured = sensor(LEVEL, TIME[:, None] / TIME[-1], np.sign(RATE)) * COMMAND
    measured = measured + NOISE * np.random.default_rng(0).standard_normal(measured.shape)
    problem = Problem(model, (Piece(COMMAND, measured),), STEP, "foh", np.array([NOISE]))
    linearized = Linearized(problem, scatter_of(model))
    (member,) = [one for one in catalogue(problem, {}) if one.name == name and one.place == "sensor"]
    candidate = Candidate((member,))
    solution = fit(linearized, candidate.unknowns(), candidate.starts()[0])
    return {one.variable: one for one in distortions(linearized, FittedHypothesis(candidate, solution, 0.0), temper)}


def test_a_gain_that_is_one_changes_with_nothing():
    found = distorted(lambda level, time, direction: 1.05)
    assert set(found) == {"time", "level", "rate", "branch"}
    assert all(one.statistic < 6.0 and abs(one.change) < 0.05 for one in found.values())


@pytest.mark.parametrize(
    ("variable", "sensor"),
    [
        ("time", lambda level, time, direction: 1.0 + 0.1 * time),
        ("level", lambda level, time, direction: 1.05 + 0.02 * level),
        ("branch", lambda level, time, direction: 1.05 + 0.02 * direction),
    ],
)
def test_the_variable_is_found_with_which_a_gain_changes(variable, sensor):
    found = distorted(sensor)
    assert max(found.values(), key=lambda one: one.statistic).variable == variable
    # The gain's deviation goes from 0 to twice its mean over time, and by 0.04 in 0.05 over level or branch.
    expected = 2.0 if variable == "time" else 0.8
    assert found[variable].change == pytest.approx(expected, rel=0.1)
    assert found[variable].statistic > 1000.0


def test_a_distortion_that_leaves_noise_alone_is_as_sure_as_noise_allows():
    """The residual is the distortion itself, slow and large: its samples must not be weighted down as a correlated error."""

    def of_time(level, time, direction):
        return 1.0 + 0.1 * time

    assert distorted(of_time, temper=1e-4)["time"].statistic == pytest.approx(distorted(of_time)["time"].statistic, rel=0.1)
    assert distorted(of_time, temper=1e-4)["rate"].statistic < 1.0


def test_what_one_stretch_of_the_record_differs_by_is_no_change_with_time():
    # As in a record whose clock slips once: a gain that falls over time would have to fall in what follows too.
    found = distorted(lambda level, time, direction: 1.05 + 0.1 * (time < 0.1))
    assert abs(found["time"].change) < CONFIGURATION.policy.distortion_change
