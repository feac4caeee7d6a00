# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Effects of the blind test, and the ranges of their sizes: each is visible, and none dominates the signal."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from evaluation.blind_test.plant_setups import SETUPS

Range = tuple[float, float]

SEVERITIES: dict[str, dict[str, Range | str]] = {
    # lengths and rates relative to the plant: "stroke" and "volt" scale with its stroke and command range, "tick" with its sample time
    "creep": {"gamma": (0.006, 0.04)},
    "gain": {"gain": (0.06, 0.18)},
    "gain_drift": {"change": (0.008, 0.05), "tau": (0.2, 1.0)},
    "offset": {"offset stroke": (0.003, 0.02)},
    "offset_drift": {"change stroke": (0.004, 0.03), "tau": (0.2, 1.0)},
    "hysteresis_width": {"width": (0.1, 0.4)},
    "hysteresis_shape": {"amount": (0.006, 0.03)},
    "hysteresis_rate": {"factor": (1.6, 3.0)},
    "delay": {"tau tick": (0.5, 6.0)},
    "amplifier_lowpass": {"cutoff": (500.0, 3000.0)},
    "sensor_lowpass": {"cutoff": (500.0, 3000.0)},
    "slew_limit": {"rate volt": (200.0, 1000.0)},
    "saturation": {"upper volt": (0.75, 0.92)},
    "dac_hold": {"samples": (3.0, 8.0)},
    "resonance": {"frequency": (300.0, 1500.0), "damping": (0.01, 0.06), "gain": (0.01, 0.05)},
    "added_mass": {"mass_ratio": (0.1, 0.4)},
    "backlash": {"half_width stroke": (0.002, 0.012)},
    "cross_coupling": {"coupling": (0.01, 0.06)},
    "sensor_nonlinearity": {"second stroke": (0.004, 0.015), "third stroke": (0.004, 0.015)},
    "sensor_noise": {"rms noise": (1.0, 4.0)},
    "flicker_noise": {"rms noise": (3.0, 12.0)},
    "mains_hum": {"amplitude noise": (1.5, 8.0)},
    "vibration": {"amplitude noise": (1.5, 8.0), "frequency": (70.0, 700.0)},
    "quantization": {"step noise": (4.0, 15.0)},
    "held_samples": {"fraction": (0.02, 0.2)},
}
"""Every effect of the catalogue with the range its parameters are drawn from, evenly in their logarithm."""

OPEN_SET: dict[str, dict[str, Range | str]] = {
    "crossover_dead_band": {"half_width volt": (0.01, 0.05)},
    "duffing_stiffness": {"share": (0.05, 0.25)},
    "wandering_mode": {"change": (0.05, 0.2)},
    "gain_scheduled_hysteresis": {"amount": (0.3, 1.2)},
    "clock_rate_mismatch": {"share": (2e-4, 2e-3)},
    "outliers": {"fraction": (0.002, 0.01), "size stroke": (0.02, 0.2)},
    "guide_friction": {"share": (0.01, 0.06)},
}
"""Effects outside the catalogue."""

EITHER_SIGN = ("width", "gain", "change", "amount", "offset", "second", "third", "coupling")

Realization = Mapping[str, str | float]

REALIZATIONS: dict[str, tuple[Realization, ...]] = {
    "creep": ({}, {"law": 2, "begin": 0.2}),
    "gain": ({}, {"at": "amplifier"}),
    "gain_drift": ({}, {"law": 1}),
    "offset_drift": ({}, {"law": 1}),
    "hysteresis_shape": ({}, {"curve": 1}),
    "delay": ({}, {"at": "sensor"}),
    "amplifier_lowpass": ({}, {"order": 2}),
    "sensor_lowpass": ({}, {"order": 2}),
    "slew_limit": ({}, {"direction": 1}),
    "dac_hold": ({}, {"phase": 1}, {"samples": 1, "step volt": 0.03}),
    "resonance": ({}, {"velocity": 1.0}),
    "backlash": ({}, {"side": -1}),
    "vibration": ({}, {"second": 0.4}),
    "flicker_noise": ({}, {"exponent": 0.8}),
    "mains_hum": ({}, {"second": 0.4}),
}
"""Realizations of an effect that every seed draws: parameters beside those of `SEVERITIES`, or in their place; {} is the usual one."""

UNTUNED: dict[str, tuple[Realization, ...]] = {
    "creep": ({"law": 1, "begin": 0.02}, {"begin": 0.02}),
    "gain": ({"at": "piezo"},),
    "gain_drift": ({"law": 2}, {"law": 3}),
    "offset_drift": ({"law": 2}, {"law": 3}),
    "hysteresis_shape": ({"curve": 2}, {"curve": 3}),
    "amplifier_lowpass": ({"damping": 0.7},),
    "sensor_lowpass": ({"damping": 0.7},),
    "slew_limit": ({"direction": -1},),
    "saturation": ({"knee volt": 0.01},),
    "dac_hold": ({"phase": 2}, {"samples": 1, "step volt": 0.03, "rounding": 1}, {"samples": 1, "step volt": 0.03, "rounding": 3}),
    "resonance": ({"velocity": 0.5},),
    "backlash": ({"side": 1},),
    "vibration": ({"steadiness": 100.0},),
    "flicker_noise": ({"exponent": 1.3},),
    "mains_hum": ({"third": 0.0, "fifth": 0.0},),
    "quantization": ({"rounding": 1},),
    "held_samples": ({"run": 4},),
}
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
