# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The ensemble of slip elements against one play operator per element, written down as it is defined."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyst_plant_sim.physics.elastic_slip import Slip

ELASTIC, SLIPPING, RANGE, DECAY, CURVATURE = 0.02, 0.05, 40.0, 15.0, 0.01


def defined(voltage: np.ndarray, elements: int, width: float) -> np.ndarray:
    slack = RANGE * (np.arange(elements) + 0.5) / max(elements, 1)
    density = np.exp(-slack / DECAY)
    weights = SLIPPING * density / max(density.sum(), 1e-300)
    place, output = np.zeros(elements), []
    for v in voltage:
        place = np.clip(place, v - slack, v + slack)
        mean = (ELASTIC + weights.sum()) * v
        y = mean + (1.0 + width) * np.sum(weights * (place - v))
        output.append(y - CURVATURE * y * y)
    return np.array(output)


@pytest.mark.parametrize("elements, width", [(0, 0.0), (1, 0.0), (7, 0.0), (40, 0.3), (40, -0.5)])
@settings(max_examples=40, deadline=None)
@given(turns=st.lists(st.floats(-60.0, 120.0), min_size=1, max_size=12), seed=st.integers(0, 99), cut=st.integers(1, 20))
def test_it_is_a_sum_of_play_operators(elements, width, turns, seed, cut):
    """Ramps from turn to turn with a jitter that turns all the time, in pieces."""
    start = 35.0
    voltage = np.concatenate([np.linspace(a, b, 8) for a, b in zip([start, *turns], turns)] + [np.full(3, turns[-1])])
    voltage += np.random.default_rng(seed).choice([0.0, 0.0, 0.7, -3.0], len(voltage))
    slip = Slip(ELASTIC, SLIPPING, elements, RANGE, DECAY, CURVATURE, width)
    found = [slip.settle(start), *np.concatenate([slip.process(voltage[i : i + cut]) for i in range(0, len(voltage), cut)])]
    np.testing.assert_allclose(found, defined(np.concatenate([[start], voltage]), elements, width), rtol=0, atol=1e-12)
