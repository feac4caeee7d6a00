# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Min/max decimation: no peak is lost, rows stay whole, and blocks of any size give the same."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyst_control.records.extremes import ExtremeRows


def decimated(bin_ticks, ticks, rows, cuts):
    """Everything that is kept when the table is given in pieces."""
    extremes, kept = ExtremeRows(bin_ticks), []
    for some, part in zip(np.split(ticks, cuts), np.split(rows, cuts)):
        kept.append(extremes.add(some, part))
    return np.concatenate([each[0] for each in kept]), np.concatenate([each[1].reshape(-1, rows.shape[1]) for each in kept])


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_peaks_of_every_bin_are_kept_however_it_is_cut(data):
    count, bin_ticks = data.draw(st.integers(1, 120)), data.draw(st.integers(1, 30))
    rng = np.random.default_rng(data.draw(st.integers(0, 1000)))
    ticks = np.flatnonzero(rng.random(2 * count) < 0.6)
    rows = rng.integers(-5, 6, (len(ticks), 3)).astype(float)
    rows[rng.random(rows.shape) < 0.1] = np.nan
    cuts = sorted(data.draw(st.lists(st.integers(0, len(ticks)), max_size=5)))
    kept, values = decimated(bin_ticks, ticks, rows, cuts)
    whole = decimated(bin_ticks, ticks, rows, [])
    np.testing.assert_array_equal(kept, whole[0])
    np.testing.assert_array_equal(values, rows[np.searchsorted(ticks, kept)])
    assert np.all(np.diff(kept) > 0)
    for number in set((ticks // bin_ticks).tolist()):
        inside = ticks // bin_ticks == number
        left = kept // bin_ticks == number
        if not left.any():  # the last bin is still open
            assert number == ticks[-1] // bin_ticks and ticks[-1] % bin_ticks < bin_ticks - 1
            continue
        assert left.sum() <= 2 * rows.shape[1]
        for column in range(rows.shape[1]):
            known = rows[inside, column][~np.isnan(rows[inside, column])]
            if len(known):
                assert np.nanmin(values[left, column]) == known.min() and np.nanmax(values[left, column]) == known.max()


def test_a_spike_of_one_tick_survives():
    rows = np.zeros((20_000, 1))
    rows[12_345] = 7.0
    kept, values = decimated(1000, np.arange(20_000), rows, [])
    assert len(kept) <= 40 and values.max() == 7.0 and 12_345 in kept


def test_a_bin_of_no_length_is_refused():
    with pytest.raises(ValueError, match="bin_ticks"):
        ExtremeRows(0)
