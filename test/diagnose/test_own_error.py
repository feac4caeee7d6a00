# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A model discrepancy in the fits: weights of samples, and tolerances of a physical size."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from hyst_control.chain import Chain
from hyst_control.chain.command_features import CommandFeatures
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.chain.memoryless import Gain
from hyst_control.diagnose.configuration import CONFIGURATION
from hyst_control.diagnose.model_error.baseline import with_discrepancy
from hyst_control.diagnose.problem.coefficient_prior import scatter_of, within_own_error
from hyst_control.diagnose.problem.per_record_stages import ErrorBasis, LearnedError
from hyst_control.diagnose.problem.problem import Piece, Problem
from hyst_control.diagnose.report.attribution import deviations
from hyst_control.diagnose.report.coefficient_changes import repetition
from hyst_control.diagnose.run.collect import _has_holes
from hyst_control.diagnose.search.candidate import Candidate
from hyst_control.diagnose.search.catalogue import catalogue
from hyst_control.diagnose.search.fit import Linearized, fit
from hyst_control.identify.model_error.learned_discrepancy import LearnedDiscrepancy
from hyst_control.model_file import Model

STEP = 1e-3
COMMAND = 10.0 * np.sin(2 * np.pi * 5.0 * STEP * np.arange(2000))[:, None]


def problem(chain: Chain, measurement: np.ndarray, **changes) -> Problem:
    tolerance = changes.pop("tolerance", {})
    model = Model("m", ("x",), {"command": "V", "measurement": "um"}, STEP, chain, "foh", tolerance=tolerance)
    return Problem(model, (Piece(COMMAND, measurement),), STEP, "foh", np.array([0.01]), **changes)


def test_a_sample_counts_as_much_as_noise_and_own_error_let_it():
    base = problem(Chain((Gain(1.0),)), COMMAND)
    assert base.weight == 1.0
    assert replace(base, own_error=np.array([0.005])).weight == 1.0  # below the noise
    assert replace(base, own_error=np.array([0.1]), own_correlation=20.0).weight == pytest.approx(1.0 / (1.0 + 20.0 * 99.0))


def test_a_noisier_record_does_not_make_the_model_better():
    """An own error of 0.1 with 0.01 of noise in it: beside a noise of 0.2 its samples still hang together."""
    base = replace(problem(Chain((Gain(1.0),)), COMMAND), own_error=np.array([0.1]), own_correlation=20.0)
    noisy = replace(base, model=replace(base.model, noise={"sigma": 0.01}), sigma=np.array([0.2]))
    assert noisy.weight == pytest.approx(1.0 / (1.0 + 20.0 * (0.1**2 - 0.01**2) / 0.2**2))


def test_the_posterior_of_a_coefficient_is_that_of_independent_samples():
    """A static gain g with prior N(1, t²) and N / n independent samples of an error e: the usual formula of a conjugate normal."""
    error, length, tolerance = 0.1, 20.0, 0.3
    seen = problem(
        Chain((TransferFunction((1.0,), (1.0,)),)),
        1.02 * COMMAND,
        own_error=np.array([error]),
        own_correlation=length,
        tolerance={"num": tolerance},
    )
    scatter = scatter_of(seen.model)
    found = fit(Linearized(seen, scatter))
    precision = 1.0 / tolerance**2 + np.sum(COMMAND**2) / (length * (error**2 - 0.01**2) + 0.01**2)
    assert np.sqrt(found.covariance[0, 0]) * tolerance == pytest.approx(precision**-0.5, rel=0.02)
    assert found.z[0] * tolerance == pytest.approx(0.02, rel=0.02)


def test_a_line_of_ten_times_the_own_error_is_as_large_as_it_is():
    """Its prior is as wide as what the samples scatter by, not as the noise, of which the line is two hundred."""
    line = 2.0 * np.sin(2 * np.pi * 61.0 * STEP * np.arange(len(COMMAND)) + 0.4)
    seen = problem(Chain((Gain(1.0),)), COMMAND + line[:, None], own_error=np.array([0.2]), own_correlation=200.0)
    linearized, found = Linearized(seen, scatter_of(seen.model)), []
    for member in catalogue(seen, {"vibration": [61.0]}):
        if member.name == "vibration":
            unknowns = Candidate((member,)).unknowns()
            found.append((member, fit(linearized, unknowns, member.starts()[0])))
    assert (1, 1) in {(len(member.line.harmonics), member.line.swells) for member, _ in found}  # a pure tone is the simplest
    for member, solution in found:
        assert member.values(solution.x)["amplitude"] == pytest.approx(2.0, rel=0.02)
        assert np.mean(solution.residual**2) < 1e-3 * np.mean((line / 0.01) ** 2)


def test_a_tolerance_of_many_times_the_value_is_cut_to_what_the_own_error_allows():
    w = 2 * np.pi * 100.0
    chain = Chain((TransferFunction((w**2,), (1.0, 0.1 * w, w**2)),))
    seen = problem(chain, COMMAND, own_error=np.array([0.1]), tolerance={"num": 178.0, "den": 178.0})
    scatter = within_own_error(scatter_of(seen.model), seen)
    nominal = seen.simulate(seen.model.chain.stages)
    for k in range(len(scatter.coefficients)):
        moved = seen.simulate(scatter.at(np.eye(len(scatter.coefficients))[k]))
        assert np.isfinite(moved).all()
        assert np.sqrt(np.mean((moved - nominal) ** 2)) * 0.01 < 0.15
    without = replace(seen, own_error=None)
    assert within_own_error(scatter_of(without.model), without).coefficients[0].tolerance == 178.0


def test_a_predicted_error_is_added_with_its_weights():
    random = np.random.default_rng(0)
    basis = ErrorBasis((random.standard_normal((2000, 2)),))
    stage = LearnedError(np.array([0.5, -2.0]), basis)
    seen = problem(Chain((Gain(1.0), stage)), COMMAND)
    expected = COMMAND[:, 0] + basis.directions[0] @ [0.5, -2.0]
    np.testing.assert_allclose(seen.rows(seen.simulate(seen.model.chain.stages))[:, 0], expected, atol=1e-9)
    assert stage.parameters() != LearnedError(np.zeros(2), basis).parameters()
    assert [c.companion for c in scatter_of(seen.model).coefficients] == [True, True]


def test_a_warm_up_is_no_hole_in_a_record():
    """The spectrum of what follows it can be read; rows left out in between tear it apart."""
    rows = np.arange(len(COMMAND))
    assert not _has_holes(Piece(COMMAND, COMMAND)) and not _has_holes(Piece(COMMAND, COMMAND, rows >= 300))
    assert not _has_holes(Piece(COMMAND, COMMAND, (rows >= 300) & (rows < 1800)))
    assert _has_holes(Piece(COMMAND, COMMAND, rows % 100 != 0)) and _has_holes(Piece(COMMAND, COMMAND, abs(rows - 900) > 3))


def test_a_learned_error_that_says_nothing_here_is_left_out():
    """Its weights are all far below what it leaves on the records that it was learned from."""
    features = CommandFeatures.of([COMMAND[:, 0]], STEP)
    count = features.rows(COMMAND[:, 0], STEP).shape[1]
    learned = LearnedDiscrepancy(features, np.full(count, 1e-9), np.full((count, 1), 1e-9), 1.0, 0.1)
    stated = {"rms": [1.0], "correlation": 0.1, "learned": [learned.document()]}
    seen = problem(Chain((Gain(1.0),)), COMMAND)
    known = with_discrepancy(replace(seen, model=replace(seen.model, discrepancy=stated)), CONFIGURATION.baseline)
    predicted = [stage for stage in known.problem.model.chain.stages if isinstance(stage, LearnedError)]
    assert len(predicted) == 1  # the initial memory alone


@pytest.mark.parametrize("freedom", [5.0, np.inf])
def test_an_interval_knows_by_how_many_records_the_own_error_was_estimated(freedom):
    """Against Student's t: as wide as its quantiles, in every direction of the covariance."""
    covariance = np.array([[4.0, 1.2], [1.2, 1.0]])
    drawn = deviations(covariance, 40_000, freedom)
    due = stats.t(freedom).ppf([0.05, 0.95])
    assert np.quantile(drawn[:, 0], [0.05, 0.95]) == pytest.approx(2.0 * due, rel=0.03)
    along = np.linalg.solve(np.linalg.cholesky(covariance), drawn.T)
    assert np.quantile(along, [0.05, 0.95], axis=1) == pytest.approx(np.stack([due, due], axis=1), rel=0.03)


def test_an_error_that_follows_the_command_tells_as_little_as_the_command_has_independent_samples():
    noise = np.random.default_rng(3).normal(size=(500, 1))
    seen = replace(problem(Chain((Gain(1.0),)), COMMAND), own_error=np.array([100.0]), own_correlation=50.0)
    assert repetition(seen) == pytest.approx(len(COMMAND) / 2 / 50.0, rel=0.01)
    assert repetition(replace(seen, pieces=(Piece(noise, noise),))) == 1.0
    assert repetition(replace(seen, own_error=None)) == 1.0
