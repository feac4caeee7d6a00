# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Generalized play operators: equal to play where nothing bends, found again where they made the record."""

import numpy as np

from evaluation.reproduction.generalized_play import GeneralizedPlay, fit_generalized_play, follow
from hyst_control.chain import Chain, Sampling
from hyst_control.chain.hysteresis.prandtl_ishlinskii import PrandtlIshlinskii

THRESHOLDS, WEIGHTS = np.array([0.0, 0.1, 0.3]), np.array([2.0, 1.0, 0.5])
CYCLE = 5.0 - 5.0 * np.cos(2 * np.pi * np.arange(201) / 200)


def test_without_a_bend_they_are_play_operators():
    """Beside the Prandtl-Ishlinskii stage."""
    rng = np.random.default_rng(1)
    signal = np.clip(np.cumsum(rng.normal(0.0, 0.1, 800)), -1.0, 1.0)
    stage = PrandtlIshlinskii(thresholds=list(THRESHOLDS), weights=list(WEIGHTS))
    running = Chain((stage,)).filter(Sampling(1e-3, 1, "zoh"))
    running.settle(np.zeros(1))
    found = follow(signal, signal, THRESHOLDS, np.zeros(3)) @ WEIGHTS
    np.testing.assert_allclose(found, running.process(signal[:, None])[:, 0], atol=1e-12)


def test_curves_that_made_a_cycle_are_found_again():
    """Other curves up and down; one curve for both cannot do it."""
    truth = GeneralizedPlay(10.0, THRESHOLDS, np.array([[-0.4, 0.0], [0.2, 0.2]]), WEIGHTS, 0.0)
    measured = truth.predict(np.concatenate([CYCLE, CYCLE[1:]]))[-len(CYCLE) :]
    fits = [fit_generalized_play(CYCLE, measured, THRESHOLDS, each_way=each_way) for each_way in (False, True)]
    assert fits[1].fitted < 1e-3 * np.ptp(measured) and fits[1].fitted < 0.1 * fits[0].fitted
    np.testing.assert_allclose(fits[1].curves, truth.curves, atol=0.05)
