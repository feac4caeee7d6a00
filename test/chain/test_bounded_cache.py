# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Results that are kept must be those of the same arguments, whatever comes in between."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hyst_control.chain import bounded_cache as module
from hyst_control.chain.bounded_cache import remembered


@dataclass(frozen=True)
class Pair:
    first: np.ndarray
    second: float


def test_the_same_arguments_give_the_same_object_and_others_do_not():
    called = []

    @remembered
    def work(pair, scale):
        called.append(scale)
        return scale * pair.first.sum() + pair.second

    one = work(Pair(np.arange(3.0), 1.0), 2.0)
    assert work(Pair(np.arange(3.0), 1.0), 2.0) is one and called == [2.0]
    assert work(Pair(np.arange(3.0), 2.0), 2.0) == one + 1.0
    assert work(Pair(np.arange(4.0), 1.0), 2.0) == 13.0
    assert work(Pair(np.array([0.0, 2.0, 1.0]), 1.0), 2.0) == one and len(called) == 4  # another order is another argument


@given(st.lists(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=3), min_size=1, max_size=40))
def test_forgetting_changes_nothing(arguments):
    kept, module.KEPT = module.KEPT, 5
    try:
        work = remembered(lambda values, array: (list(values), array.tolist()))
        for values in arguments:
            assert work(values, np.array(values)) == (values, values)
    finally:
        module.KEPT = kept
