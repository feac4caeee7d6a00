# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A slice of `make fuzz`."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

sys.path.insert(0, str(Path(__file__).parent))
from targets import TARGETS


@pytest.mark.parametrize("name", TARGETS)
def test_odd_input_is_read_or_refused_in_one_line(name):
    inputs, reader, share = TARGETS[name]

    @settings(max_examples=int(6 + 100 * share), deadline=20_000, database=None, suppress_health_check=list(HealthCheck))
    @given(st.data())
    def read(data):
        reader(data.draw(inputs))

    read()
