# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Likelihood of a residual by octaves against numerical integration over the scale of an octave."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import invgamma

from hyst_control.diagnose.likelihood.octaves import Octaves


def octaves(sizes: list[int], own: list[float] | None = None, freedom: float = 4.0) -> Octaves:
    """Octaves of these sizes, of noise alone unless a share of the model's discrepancy is given."""
    count = len(sizes)
    shares = np.zeros(count) if own is None else np.array(own)
    return Octaves(np.repeat(np.arange(count), sizes), shares, np.full(count, freedom), 1e9, np.ones(count), count)


def constant(count: int) -> float:
    """Part of a normal log density that the likelihood leaves out."""
    return -0.5 * count * np.log(2.0 * np.pi)


@pytest.mark.parametrize("freedom", [2.0, 5.0])
def test_the_density_integrates_the_scale_of_the_octave_out(freedom):
    some, residual = octaves([5]), np.random.default_rng(0).normal(0.0, 2.0, 5)
    variance = 1.7

    def at_scale(scale: float) -> float:
        density = np.exp(-0.5 * np.sum(residual**2) / (scale * variance)) / (2 * np.pi * scale * variance) ** 2.5
        return density * invgamma.pdf(scale, 0.5 * freedom, scale=0.5 * freedom)

    expected = np.log(quad(at_scale, 0.0, np.inf)[0])
    found = some.log_density(some.energies(residual), np.array([variance]), np.array([freedom]))
    assert found + constant(5) == pytest.approx(expected, abs=1e-6)


def test_a_scale_that_is_known_gives_the_normal_density():
    some = octaves([3, 4])
    residual, variance = np.arange(1.0, 8.0), np.array([2.0, 0.5])
    each = np.repeat(variance, [3, 4])
    expected = float(np.sum(-0.5 * residual**2 / each - 0.5 * np.log(2 * np.pi * each)))
    found = some.log_density(some.energies(residual), variance, np.full(2, 1e10))
    assert found + constant(7) == pytest.approx(expected, abs=1e-4)


def test_weights_of_least_squares_have_the_slope_of_the_density():
    some = replace(octaves([6, 9]), weight=np.array([0.4, 1.0]))
    energies, variance, freedom, step = np.array([8.0, 30.0]), np.array([1.5, 1.0]), np.array([3.0, 50.0]), 1e-4
    for octave in range(2):
        more = energies + step * np.eye(2)[octave]
        slope = (some.log_density(more, variance, freedom) - some.log_density(energies, variance, freedom)) / step
        assert -0.5 * some.precision(energies, variance, freedom)[octave] == pytest.approx(slope, rel=1e-3)


def test_noise_alone_has_a_known_scale_and_a_discrepancy_has_not():
    degrees = octaves([8, 8, 8], [0.0, 0.5, 1.0]).degrees(np.ones(3), 3.0)
    assert degrees[0] > 1e6
    assert degrees[1] == pytest.approx(16.0, rel=1e-3)  # half of the variance: a quarter of the relative variance of the scale
    assert degrees[2] == pytest.approx(4.0, rel=1e-3)


def test_an_error_of_the_effects_stage_makes_the_scale_unknown_too():
    some = octaves([8])
    assert some.degrees(np.array([1.0]), 3.0)[0] > 1e6
    assert some.degrees(np.array([1e6]), 3.0)[0] == pytest.approx(3.0, rel=1e-3)


def test_octaves_with_a_models_error_count_as_few_values():
    some = octaves([16, 1000, 1000], [0.0, 0.0, 1.0]).weighted(np.array([1.0, 1.0, 1.0]), 8.0)
    assert some.weight * some.sizes == pytest.approx([16.0, 1000.0, 8.0])
    left = octaves([1000]).weighted(np.array([1e9]), 8.0)
    assert left.weight[0] * 1000 == pytest.approx(8.0, rel=1e-3)
    assert octaves([4]).weighted(np.array([1e9]), 8.0).weight[0] == 1.0  # never more values than coefficients
