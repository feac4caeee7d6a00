# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Setups of the blind test's plants: drive and scatter of the coefficients of each."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from evaluation.data_files import table_file
from hyst_control.base.yaml_files import read_yaml
from hyst_plant_sim.physics.plant_files import shipped

PLANTS = ("pea_published", "fsm_published", "pea_published", "third", "pea_published")
"""Plants of the blind test, in turn; `SETUPS` has others that an option selects.

A mirror takes three times as long as a single axis. Most effects on `third` are below its model discrepancy, which hides them; the
injected cases have it with sizes relative to that error.
"""

SCATTER = 0.01
"""Relative standard deviation of every coefficient of a plant about the nominal one."""

TOLERANCE = ("weights", "m1", "m2", "k", "b", "w0", "num", "den", "ascending", "descending", "tau", "k1", "k2", "b2")


@dataclass(frozen=True)
class Setup:
    """Drive of a plant."""

    model: str | None  # Model file; None: identified
    sample_time: float  # Sample time, s
    command: tuple[float, float]  # Range of the command, V
    stroke: float  # Stroke (measurement unit)
    scattered: tuple[str, ...]  # Names of the coefficients that scatter
    # Gains of the closed loop: proportional (V per unit) and integral (V per unit and s)
    gains: tuple[float, float]


FILE: dict[str, dict[str, Any]] = table_file("blind_test/plants.yaml")
SETUPS = {name: Setup(**values) for name, values in FILE["setups"].items()}
IDENTIFICATION: dict[str, tuple[str, dict[str, Any]]] = FILE["identification"]
"""By plant without a published model: the family, and the excitation that identifies it beside the diagnostic record."""


def scatter(plant: str, seed: int, size: float) -> dict[str, Any]:
    """Scatter the coefficients of a plant; both axes of a mirror about the first axis' values."""
    parameters = _parameters(plant)
    random = np.random.default_rng([seed, 2])
    setup = SETUPS[plant]

    def off(value: Any) -> Any:
        return [off(item) for item in value] if isinstance(value, list) else value * (1.0 + size * random.standard_normal())

    if plant != "fsm_published":
        return {name: off(parameters[name]) for name in setup.scattered}
    changes = {name: [off(parameters[name][0]) for _ in range(2)] for name in setup.scattered}
    for name in ("span", "scale", "b2"):
        changes[name] = [parameters[name][0]] * 2
    for axis in range(2):  # the major branches meet at their end
        ends = [sum(changes[name][axis]) for name in ("ascending", "descending")]
        for name, end in zip(("ascending", "descending"), ends, strict=True):
            changes[name][axis] = [value * 0.5 * sum(ends) / end for value in changes[name][axis]]
    return changes


@cache
def _parameters(plant: str) -> dict[str, Any]:
    path = shipped(plant)
    assert path is not None
    parameters: dict[str, Any] = read_yaml(path)["parameters"]
    return parameters
