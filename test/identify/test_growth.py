# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Growth of a model's dynamics: which structures are given more states, and what decides on rows fitted and on rows held out."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import cont2discrete, lfilter

import hyst_control as hc
from hyst_control.chain.linear.linear_stages import LinearStage
from hyst_control.identify.modal.linear_candidate import VARIANTS
from hyst_control.identify.modal.linear_search import _variants_to_grow
from hyst_control.identify.play.hammerstein import MIN_IMPROVEMENT, PAIR_IMPROVEMENT, _plainest, _relative_error
from hyst_control.identify.solve.gram_sums import HELD_OUT_BLOCKS

errors = st.floats(1e-12, 1e12)


def trial(held_out, fitted=1.0):
    return SimpleNamespace(held_out=held_out, fitted=fitted)


@given(known=st.dictionaries(st.sampled_from(VARIANTS), errors), going=st.sets(st.sampled_from(VARIANTS), min_size=1))
def test_some_variant_always_goes_on(known, going):
    """Also where one that was given up left less, with fewer states, than any that goes on."""
    variants = [each for each in VARIANTS if each in going]
    left = _variants_to_grow(variants, {each: trial(error) for each, error in known.items()})
    assert left and set(left) <= set(variants)
    assert min(variants, key=lambda each: known.get(each, 0.0)) in left


def test_a_fall_in_fitted_rows_alone_counts_by_a_part():
    assert _relative_error(trial(1.0, 0.6), trial(1.0)) == pytest.approx(1.0 - 0.4 * MIN_IMPROVEMENT / PAIR_IMPROVEMENT)
    assert _relative_error(trial(0.5, 0.6), trial(1.0)) == 0.5  # what falls on rows held out counts whole
    assert _relative_error(trial(1.01, 0.1), trial(1.0)) == 1.01  # and where it rises there, nothing else counts
    assert (
        _relative_error(trial(0.98, 0.61), trial(1.0)) < 1.0 - MIN_IMPROVEMENT
    )  # a mode that steps excite, 664 Hz behind a hysteresis


def test_the_plainest_of_those_that_fit_alike_is_taken():
    plain, rich, poor = trial(0.91), trial(0.9), trial(0.99)
    assert _plainest([plain, rich, poor], trial(1.0), 0.97) is plain
    assert _plainest([poor, rich], trial(1.0), 0.97) is rich
    assert _plainest([poor], trial(1.0), 0.97) is None and _plainest([], trial(1.0), 0.97) is None


def test_a_pole_slower_than_a_sixth_of_the_record_is_no_part_of_the_model():
    """A lag of 2.5 s with 3 % of the motion, in a record of 3 s: beside the drift its static gain would be arbitrary."""
    rate, random = 1000.0, np.random.default_rng(3)
    time = np.arange(3000) / rate
    ends = [0, 112, 8, 100, 18, 84, 30, 70, 50, *random.uniform(10.0, 90.0, 12)]
    command = np.interp(time, np.linspace(0.02, 3.0, len(ends)), ends)
    inner = 0.07 * command
    for threshold, weight in ((3.0, 0.01), (11.0, 0.012), (24.0, 0.01), (40.0, 0.008)):
        state, rows = 0.0, np.empty(len(command))
        for row, value in enumerate(command):
            rows[row] = state = max(value - threshold, min(value + threshold, state))
        inner = inner + weight * rows
    share, fast = 1.0 / (2.5 * rate), 0.25
    fast_rows = lfilter([0.0, fast], [1.0, fast - 1.0], inner)
    measured = fast_rows + 0.03 * lfilter([0.0, share], [1.0, share - 1.0], inner) + 2e-3 * random.standard_normal(len(command))
    model = hc.identify(hc.from_arrays(command, measured, rate, hold="zoh"), family="hapi", verbose=False)
    linear = [stage for stage in model.chain.stages if isinstance(stage, LinearStage)]
    poles = np.concatenate([np.linalg.eigvals(system.A) for stage in linear for system in stage.systems(1)] or [np.zeros(0)])
    assert np.all(np.abs(poles) > 0.99 * 6.0 / 3.0)


def test_a_mode_that_only_fitted_rows_show_is_found():
    """Steps in the first of three blocks: in the third one, which is held out, the ringing has decayed."""
    rate, block, random = 10_000.0, 200, np.random.default_rng(5)
    command = np.repeat(random.uniform(10.0, 90.0, HELD_OUT_BLOCKS // 3), 3 * block)
    inner = 0.07 * command
    for threshold, weight in ((3.0, 0.02), (15.0, 0.02), (30.0, 0.01)):
        state, rows = 0.0, np.empty(len(command))
        for row, value in enumerate(command):
            rows[row] = state = max(value - threshold, min(value + threshold, state))
        inner = inner + weight * rows
    root = 2 * np.pi * 500.0
    top, bottom, _ = cont2discrete(((root**2,), (1.0, 0.1 * root, root**2)), 1.0 / rate, "zoh")
    # A hysteresis that play operators do not describe: its error hides the ringing in held-out rows.
    inner = inner + 2e-3 * (command - 50.0) ** 2
    measured = inner[0] + lfilter(np.ravel(top), bottom, inner - inner[0]) + 2e-3 * random.standard_normal(len(command))
    model = hc.identify(hc.from_arrays(command, measured, rate, hold="zoh"), family="hapi", verbose=False)
    linear = [stage for stage in model.chain.stages if isinstance(stage, LinearStage)]
    poles = np.concatenate([np.linalg.eigvals(system.A) for stage in linear for system in stage.systems(1)] or [np.zeros(0)])
    assert np.any(np.abs(np.abs(poles) / root - 1.0) < 0.02)
