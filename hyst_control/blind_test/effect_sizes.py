"""Effects of the blind test, and the ranges of their sizes: each is visible, and none dominates the signal."""

from __future__ import annotations

from typing import Any

import numpy as np

from hyst_control.blind_test.plant_setups import SETUPS

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

NOISE_LIKE = ("sensor_noise", "flicker_noise", "quantization", "held_samples", "mains_hum", "vibration", "outliers")


def draw_effect(name: str, plant: str, noise: float, random: np.random.Generator) -> dict[str, Any]:
    """Draw the parameters of an effect from its range.

    Parameters
    ----------
    name
        Name of the effect.
    plant
        Truth plant, whose scales the range refers to.
    noise
        Noise of the sensor, rms / stroke.
    random
        Random numbers.

    Returns
    -------
    dict[str, Any]
        The effect, a mapping that `load_plant` takes.
    """
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
