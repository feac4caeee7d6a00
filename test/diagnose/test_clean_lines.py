# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Lines that baseline records have too, in another phase."""

from __future__ import annotations

import numpy as np

from hyst_control.diagnose.configuration import CONFIGURATION
from hyst_control.diagnose.record_checks.lines_in_clean import beyond_clean

STEP, TIME = 1e-3, 1e-3 * np.arange(3000)
NOISE = np.random.default_rng(0).standard_normal((2, 3000))


def line(amplitude: float, phase: float) -> np.ndarray:
    return amplitude * np.sin(2 * np.pi * 50.0 * TIME + phase)


def test_hum_is_new_where_no_clean_record_has_it_nearly_as_large():
    suggested = {"mains_hum": [50.0], "vibration": [123.0], "dac_hold": [0.25]}
    for usual, left in ((1.0, []), (0.2, [50.0]), (0.0, [50.0])):
        new = (line(1.5, 1.0) + 0.1 * NOISE[0])[:, None]
        clean = (line(usual, 4.0) + 0.1 * NOISE[1])[:, None]
        found = beyond_clean(suggested, new, [clean], STEP, CONFIGURATION.checks)
        assert found == {"mains_hum": left, "vibration": [123.0], "dac_hold": [0.25]}
