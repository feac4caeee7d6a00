# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""One value for an effect that several axes have, from each axis' own and its interval."""

from __future__ import annotations

import numpy as np
import pytest

from hyst_control.diagnose.report.attribution import Named, _joined, _rank


def axis(value, half, name="tau", unit="s"):
    return {name: (value, (value - half, value + half), unit)}


def test_axes_alike_know_more_together_and_axes_apart_less():
    together = _joined([axis(2.0, 0.1), axis(2.02, 0.1)])["tau"]
    assert together[0] == pytest.approx(2.01) and together[1] == pytest.approx((2.01 - 0.1 / np.sqrt(2), 2.01 + 0.1 / np.sqrt(2)))
    apart = _joined([axis(2.0, 0.1), axis(4.0, 0.1)])["tau"]
    assert apart[1][0] <= 2.0 and apart[1][1] >= 4.0
    assert _joined([axis(2.0, 1e-3), axis(2.1, 1.0)])["tau"][0] == pytest.approx(2.0, abs=1e-3)


@pytest.mark.parametrize("halves", [(0.0, 0.0), (0.0, 0.3), (1e-250, 1e-250)])
def test_values_without_an_interval_stay_values(halves):
    """The step of a converter that only holds is 0, and known to be."""
    value, (low, high), _ = _joined([axis(0.0, half) for half in halves])["tau"]
    assert value == 0.0 and np.isfinite([low, high]).all() and low <= 0.0 <= high


def test_noise_that_is_a_small_part_of_the_gap_stands_behind_what_explains_it():
    delay, slight = Named("delay", ("x",), 0.89, shrink=0.9), Named("sensor_noise", ("x",), 1.0, share=0.2)
    assert sorted([slight, delay], key=_rank) == [delay, slight]
    main, held = Named("sensor_noise", ("x",), 1.0, share=0.9), Named("held_samples", ("x",), 1.0)
    assert sorted([delay, main], key=_rank) == [main, delay] and sorted([delay, held], key=_rank) == [held, delay]
