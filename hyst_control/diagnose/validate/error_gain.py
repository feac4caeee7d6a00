# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""The model discrepancy as an explanation passes it on: effects of the sensor act on the output of the machine, error included.

A sensor whose gain is half as much again shows the model's error half as large again, and a bend enlarges it where the curve is steep.
What the right effect of the right size leaves is therefore the model's error as the effect passes it on, and a share of the gap at
that.
"""

from __future__ import annotations

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.diagnose.problem.per_record_stages import CarriedError
from hyst_control.diagnose.problem.problem import Problem
from hyst_control.diagnose.search.beam_search import FittedHypothesis
from hyst_control.diagnose.search.fit import Linearized, is_bounded
from hyst_control.effects.placement import insert

SIZE = 0.01
"""Of the probe, rms, as a share of the range of the measurement: small beside any effect, large beside rounding."""
PERIODS = 40
"""Turns of the probe, a random line, in a record."""


def error_gain(linearized: Linearized, scored: FittedHypothesis) -> float:
    """Measure the energy with which a small slow error of the model passes the effects of an explanation."""
    candidate, solution, problem = scored.candidate, scored.solution, linearized.problem
    if candidate is None:
        return 1.0
    probe = CarriedError(_probe(problem))
    unknowns = candidate.unknowns()
    try:
        stages = linearized.scatter.at(solution.z)
        beside = insert(stages, "sensor", probe)
        alone = problem.simulate(beside) - problem.simulate(stages)
        passed = problem.simulate(unknowns.stages(beside, solution.x)) - problem.simulate(unknowns.stages(stages, solution.x))
    except InputError:
        return 1.0
    before = float(alone @ alone)
    if not before > 0.0 or not is_bounded(passed):
        return 1.0
    return float(passed @ passed) / before


def _probe(problem: Problem) -> tuple[Array, ...]:
    """Random lines (N, A) through a few points, by record."""
    random = np.random.default_rng(0)
    found = []
    for piece in problem.pieces:
        rows, axes = piece.measurement.shape
        at = np.linspace(0.0, rows - 1.0, min(PERIODS, rows) + 1)
        size = SIZE * np.ptp(piece.measurement, axis=0)
        found.append(
            size * np.stack([np.interp(np.arange(rows), at, random.standard_normal(len(at))) for _ in range(axes)], axis=1)
        )
    return tuple(found)
