# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Structure of a gap, on machines whose nonlinearity is written down here: parity and memory are known."""

from __future__ import annotations

import numpy as np
import pytest

from hyst_control.chain import Chain
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.diagnose.report.gap_structure import Regression, answers, features
from hyst_control.model_file import Model, simulate

MODEL = Model(
    "lag and mode",
    ("x",),
    {"command": "V", "measurement": "um"},
    1e-3,
    Chain((TransferFunction([4e4], [1.0, 60.0, 4e4]),)),
)
ROWS = 6000


def command() -> np.ndarray:
    random, time = np.random.default_rng(7), 1e-3 * np.arange(ROWS)
    lines = np.arange(0.5, 25.0, 0.5)
    return 10.0 * np.sin(2 * np.pi * np.outer(time, lines) + random.uniform(0, 2 * np.pi, len(lines))).sum(axis=1) / 5.0


def through(values: np.ndarray) -> np.ndarray:
    return simulate(MODEL, values[:, None])[:, 0]


def play(values: np.ndarray, half_width: float) -> np.ndarray:
    place, found = 0.0, []
    for value in values:
        place = min(max(place, value - half_width), value + half_width)
        found.append(place)
    return np.array(found)


MACHINES = {
    "cubic characteristic of the drive": (lambda u: through(u - 1e-3 * u**3), False, False, True),
    "one-sided saturation of the drive": (lambda u: through(np.minimum(u, 6.0)), False, True, True),
    "bent sensor": (lambda u: through(u) + 0.01 * through(u) ** 2, False, True, False),
    "rectifier between two filters": (lambda u: through(0.1 * np.abs(through(u)) + u), False, True, False),
    "play of the drive": (lambda u: through(play(u, 3.0)), True, False, True),
    "play behind the mechanics": (lambda u: play(through(u), 3.0), True, False, True),
}


@pytest.mark.parametrize("name", MACHINES)
def test_parity_and_memory_are_found(name):
    machine, memory, even, odd = MACHINES[name]
    u = command()
    noise = 0.01 * np.random.default_rng(1).standard_normal(ROWS)
    simulated = through(u)
    columns = features(MODEL, u[:, None], simulated[:, None], 0)
    gap = machine(u) + noise - simulated
    found = answers([Regression(gap[200:], [each[200:] for each in columns])])
    assert {question: probability > 0.5 for question, probability in found.items()} == {"memory": memory, "even": even, "odd": odd}


def test_noise_has_no_structure():
    u = command()
    columns = features(MODEL, u[:, None], through(u)[:, None], 0)
    found = answers([Regression(np.random.default_rng(2).standard_normal(ROWS), columns)])
    assert max(found.values()) < 0.1
