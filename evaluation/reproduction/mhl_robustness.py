# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Margins of a tuned feedback on the reference simulation, beside those of its model."""

from __future__ import annotations

from evaluation.reproduction.measured_margins import measured_margins
from hyst_control.base.errors import InputError
from hyst_control.control.tuning import Tuning
from hyst_control.reporting.tables import Table
from hyst_plant_sim.physics import load_plant


def robustness(table: Table, tuning: Tuning, plant: str = "fsm", title: str = "MHL robustness") -> None:
    """Add the tuned loop of its model, and its margins on the reference simulation with other gains and first modes."""
    gains = (("kp", "V/unit"), ("ki", "V/(unit s)"), *((("roll_off", "Hz"),) if tuning.roll_off else ()), ("settling_time", "s"))
    for quantity, unit in gains:
        table.add(title, "model", "tuned PI", quantity, unit, getattr(tuning, quantity))
    table.add(title, "model", "tuned PI", "bandwidth", "Hz", tuning.nominal.bandwidth)
    for quantity, unit in (("gain_margin", "dB"), ("phase_margin", "deg"), ("peak_sensitivity", "")):
        table.add(title, "model, worst case", "tuned PI", quantity, unit, getattr(tuning.worst, quantity))
    for gain in (0.9, 1.0, 1.1):
        for mode in (0.8, 1.0, 1.2):
            found = truth_margins(tuning, gain, mode, plant)
            case = f"truth, gain {gain - 1:+.0%}, first mode {mode - 1:+.0%}"
            table.add(title, case, "tuned PI", "gain_margin", "dB", found[0])
            table.add(title, case, "tuned PI", "phase_margin", "deg", found[1])


def truth_margins(tuning: Tuning, gain: float, mode: float, plant: str = "fsm") -> tuple[float, float]:
    """Measure gain and phase margin on a changed reference simulation."""
    modes, centre, rms, top = MEASURED[plant]
    found = []
    for axis in range(len(modes)):
        given = {"plant": plant, "effects": [{"name": "gain", "gain": gain - 1.0}] if gain != 1.0 else []}
        frequency = [mode * value for value in modes] if len(modes) > 1 else mode * modes[0]
        truth = load_plant(given, seed=axis, sample_time=tuning.sample_time, mode_frequency=frequency)
        try:
            found.append(measured_margins(truth, tuning.controller(0.0, top), len(modes), axis, centre, rms))
        except InputError:
            return float("nan"), float("nan")
    return min(each.gain_margin for each in found), min(each.phase_margin for each in found)


MEASURED = {"fsm": ((1930.0, 1965.0), 1.0, 0.02, 100.0), "pea": ((1231.0,), 6.0, 0.1, 150.0)}
"""First modes in Hz, of the plants' files: only for moving them where the tuned loop is put to the test; operating point and rms
of the reference's multisine in the measurement unit; upper rating in V."""
