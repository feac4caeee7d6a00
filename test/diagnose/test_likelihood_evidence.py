# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Marginal likelihood against numerical integration, and against a dense Gaussian where all is linear."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import multivariate_normal

from hyst_control.diagnose.likelihood.evidence import Fit, log_evidence
from hyst_control.diagnose.likelihood.octaves import Octaves
from hyst_control.diagnose.search.fit import TAIL

COUNT, GRID = 40, 121
HALVES = Octaves(np.repeat([0, 1], COUNT // 2), np.zeros(2), np.full(2, 4.0), 1e9, np.ones(2), 2)
VARIANCE, KNOWN = np.array([1.0, 2.5]), np.full(2, 1e10)
CONSTANT = -0.5 * COUNT * np.log(2.0 * np.pi)


def problem(columns: int, seed: int = 1, size: float = 0.6) -> tuple[np.ndarray, np.ndarray]:
    """A design and a residual that it explains in part."""
    random = np.random.default_rng(seed)
    design = size * random.standard_normal((COUNT, columns))
    return design, design @ random.standard_normal(columns) + random.standard_normal(COUNT)


def fit_of(design: np.ndarray, residual: np.ndarray, heavy: list[bool], bound: float = np.inf) -> Fit:
    """A fit that begins in the middle of its prior."""
    free = np.full(design.shape[1], bound)
    return Fit.of(HALVES, residual, design, np.zeros(design.shape[1]), np.array(heavy), (-free, free))


def heavy_density(x: np.ndarray) -> np.ndarray:
    """Density of the heavy-tailed prior."""
    whole = quad(lambda a: (1.0 + (a / TAIL) ** 2) ** (-0.5 * TAIL**2), -np.inf, np.inf)[0]
    return (1.0 + (x / TAIL) ** 2) ** (-0.5 * TAIL**2) / whole


@pytest.mark.parametrize("freedom", [1e10, 6.0])
def test_two_parameters_against_integration(freedom):
    design, residual = problem(2, size=0.9)
    degrees = np.full(2, freedom)

    z, x = np.meshgrid(np.linspace(-6.0, 6.0, GRID), np.linspace(-6.0, 6.0, GRID), indexing="ij")
    energies = np.stack(
        [
            r @ r - 2.0 * (z * (r @ a) + x * (r @ b)) + z**2 * (a @ a) + 2.0 * z * x * (a @ b) + x**2 * (b @ b)
            for r, a, b in ((residual[part], *design[part].T) for part in (HALVES.index == 0, HALVES.index == 1))
        ],
        axis=-1,
    )
    likelihood = np.array([HALVES.log_density(energy, VARIANCE, degrees) for energy in energies.reshape(-1, 2)])
    density = np.exp(likelihood.reshape(z.shape) - 0.5 * z**2) / np.sqrt(2.0 * np.pi) * heavy_density(x)
    expected = np.log(np.sum(density) * (12.0 / (GRID - 1)) ** 2)
    found = log_evidence(fit_of(design, residual, [False, True]), HALVES, VARIANCE, degrees)
    assert found.value == pytest.approx(expected, abs=0.05)


def test_linear_coefficients_against_a_dense_gaussian():
    design, residual = problem(5, seed=3)
    covariance = np.diag(np.repeat(VARIANCE, COUNT // 2)) + design @ design.T
    expected = multivariate_normal(np.zeros(COUNT), covariance).logpdf(residual)
    found = log_evidence(fit_of(design, residual, [False] * 5), HALVES, VARIANCE, KNOWN)
    assert found.value + CONSTANT == pytest.approx(expected, abs=1e-4)


def test_a_wider_prior_costs_the_logarithm_of_its_width():
    design, residual = problem(1, seed=5, size=3.0)
    narrow = fit_of(design, residual, [False])
    values = [log_evidence(narrow.scaled(np.array([width])), HALVES, VARIANCE, KNOWN).value for width in (100.0, 1000.0)]
    assert values[0] - values[1] == pytest.approx(np.log(10.0), abs=0.01)


def test_what_is_not_fitted_changes_nothing():
    design, residual = problem(3, seed=2)
    whole, alone = fit_of(design, residual, [False, True, False]), fit_of(design[:, :2], residual, [False, True])
    without = whole.scaled(np.array([1.0, 1.0, 0.0]))
    assert log_evidence(without, HALVES, VARIANCE, KNOWN).value == pytest.approx(
        log_evidence(alone, HALVES, VARIANCE, KNOWN).value, abs=1e-9
    )


def test_a_parameter_stays_within_its_range_and_the_others_go_on():
    design, residual = problem(2, seed=4)
    residual = residual + 5.0 * design[:, 0]
    bounded = log_evidence(fit_of(design, residual, [True, True], bound=1.0), HALVES, VARIANCE, KNOWN).fit
    assert bounded.value[0] == pytest.approx(1.0)
    left = residual - design[:, 0]
    weights = 1.0 / np.repeat(VARIANCE, COUNT // 2)
    slope = float(design[:, 1] @ (weights * (left - design[:, 1] * bounded.value[1])))
    pull = bounded.value[1] / (1.0 + (bounded.value[1] / TAIL) ** 2)
    assert slope == pytest.approx(pull, abs=0.05) or abs(bounded.value[1]) == pytest.approx(1.0)


def test_derivatives_that_run_away_end_in_no_error_and_are_not_for_free():
    """At the edge of stability every derivative is the same runaway: beside these the curvature's other directions are rounding."""
    design, residual = problem(2)
    wild = np.hstack([design, 1e36 * design[:, :1] * np.array([1.0, 1.0, 2.0])])
    degrees = np.full(2, 6.0)
    usual = log_evidence(fit_of(design, residual, [False, True]), HALVES, VARIANCE, degrees).value
    found = log_evidence(fit_of(wild, residual, [False] + 4 * [True], 40.0), HALVES, VARIANCE, degrees).value
    assert np.isfinite(found) and found < usual - 50.0
