# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Effects of the blind test, and the ranges of their sizes: each is visible, and none dominates the signal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from evaluation.blind_test.plant_setups import SETUPS
from evaluation.data_files import table_file

Range = tuple[float, float]

FILE: dict[str, dict[str, Any]] = table_file("blind_test/effects.yaml")
SEVERITIES: dict[str, dict[str, Range]] = FILE["sizes"]
"""Every effect of the catalogue with the range its parameters are drawn from, evenly in their logarithm."""

OPEN_SET: dict[str, dict[str, Range]] = FILE["open_set"]
"""Effects outside the catalogue."""

EITHER_SIGN = ("width", "gain", "change", "amount", "offset", "second", "third", "coupling")

Realization = Mapping[str, str | float]

REALIZATIONS: dict[str, tuple[Realization, ...]] = FILE["realizations"]
"""Realizations of an effect that every seed draws: parameters beside those of `SEVERITIES`, or in their place; {} is the usual one."""

UNTUNED: dict[str, tuple[Realization, ...]] = FILE["untuned"]
"""Realizations that only scoring seeds draw."""

SCORING_SEEDS = 100_000
"""First of the seeds for scoring; those for tuning are below 1000."""

NOISE_LIKE = ("sensor_noise", "flicker_noise", "quantization", "held_samples", "mains_hum", "vibration", "outliers")


def draw_effect(name: str, plant: str, noise: float, random: np.random.Generator) -> dict[str, Any]:
    """Draw the parameters of an effect from its range."""
    setup = SETUPS[plant]
    scale = {
        "stroke": setup.stroke,
        "volt": setup.command[1] - setup.command[0],
        "tick": setup.sample_time,
        "noise": noise * setup.stroke,
    }
    effect: dict[str, Any] = {"name": name}
    for key, limits in {**SEVERITIES, **OPEN_SET}[name].items():
        parameter, _, unit = key.partition(" ")
        value = float(np.exp(random.uniform(*np.log(limits)))) * scale.get(unit, 1.0)
        effect[parameter] = float(np.rint(value)) if parameter == "samples" else value
        if parameter in EITHER_SIGN and random.random() < 0.5:
            effect[parameter] *= -1.0
    if name == "mains_hum":
        effect["frequency"] = float(random.choice([50.0, 60.0]))
    if plant.startswith("fsm") and random.random() < 0.7:
        effect["axis"] = str(random.choice(["x", "y"]))
    return effect


def draw_realization(name: str, plant: str, seed: int, random: np.random.Generator) -> tuple[dict[str, Any], bool]:
    """Draw a realization of an effect: of a seed for tuning one of those that tuning may see, else one of all."""
    tuned = REALIZATIONS.get(name, ({},))
    known = tuned + (UNTUNED.get(name, ()) if seed >= SCORING_SEEDS else ())
    index = int(random.integers(len(known)))
    span = SETUPS[plant].command[1] - SETUPS[plant].command[0]
    parameters = {
        key.removesuffix(" volt"): float(value) * span if key.endswith(" volt") else value for key, value in known[index].items()
    }
    return parameters, index >= len(tuned)
