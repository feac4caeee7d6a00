# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Structure of a gap outside the catalogue: what was put into a record is answered with yes, what was not with no."""

import numpy as np
import pytest

from hyst_control.chain.command_features import CommandFeatures
from hyst_control.diagnose.likelihood.evidence import Fit
from hyst_control.diagnose.likelihood.fits import Fits, Hypothesis
from hyst_control.diagnose.likelihood.hypotheses import Priors
from hyst_control.diagnose.likelihood.octaves import Octaves
from hyst_control.diagnose.likelihood.structure import structure

STEP, ROWS = 1e-3, 1024
TIME = STEP * np.arange(ROWS)
COMMAND = 50.0 + 30.0 * np.sin(2 * np.pi * 3.0 * TIME) + 15.0 * np.sin(2 * np.pi * 11.3 * TIME + 1.0)
OCTAVES = Octaves(np.minimum(np.arange(ROWS) // 128, 7), np.zeros(8), np.full(8, 4.0), 1e9, np.ones(8), 8)


def features() -> np.ndarray:
    """Features of the command and of a clock of another rate, each of rms 1, in any orthonormal basis: that of time."""
    rows = CommandFeatures.of([COMMAND], STEP).rows(COMMAND, STEP)
    rows = np.column_stack([rows, TIME * np.gradient(COMMAND)])
    rows -= rows.mean(axis=0)
    return rows / np.sqrt(np.mean(rows**2, axis=0))


def play(half_width: float) -> np.ndarray:
    """Play operator on the command, without its mean."""
    out, state = np.empty(ROWS), COMMAND[0]
    for k, u in enumerate(COMMAND):
        state = min(max(state, u - half_width), u + half_width)
        out[k] = state
    return out - out.mean()


def answers(gap: np.ndarray) -> dict[str, float]:
    """Answers on a gap beside noise of rms 1."""
    design = features()
    residual = gap + np.random.default_rng(0).standard_normal(ROWS)
    count = design.shape[1]
    free = np.full(count, np.inf)
    fit = Fit.of(OCTAVES, residual, design, np.zeros(count), np.zeros(count, bool), (-free, free))
    nothing = Hypothesis(0, (), False, 1.0, False, fit, 0, 0, 0, np.zeros(8), 0.0)
    return structure(Fits(OCTAVES, (nothing,), 1, np.full(8, 1.0), np.ones(8)), None, Priors(features=(0.3, 1.0, 3.0, 10.0)))


LEVEL = (COMMAND - COMMAND.mean()) / 30.0
CASES = {
    "memory": (8.0 * (play(12.0) - COMMAND + COMMAND.mean()) / 10.0, {"memory": True, "even": False, "clock": False}),
    "even": (8.0 * (LEVEL**2 - np.mean(LEVEL**2)), {"even": True, "memory": False, "clock": False}),
    "odd": (8.0 * LEVEL**3, {"even": False, "memory": False, "clock": False, "slow": False}),
    "clock": (8.0 * TIME * np.gradient(COMMAND), {"clock": True, "memory": False, "even": False}),
}


@pytest.mark.parametrize("put_in", CASES)
def test_what_was_put_in_is_found_and_nothing_else(put_in):
    gap, expected = CASES[put_in]
    found = answers(gap)
    assert {question: found[question] > 0.5 for question in expected} == expected, found
