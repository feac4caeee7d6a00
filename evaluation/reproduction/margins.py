# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Margins of a tuned feedback, beside those of its model: as measured on the reference simulation, a multisine on the reference."""

from __future__ import annotations

import numpy as np

from hyst_control.base.arrays import Complex
from hyst_control.base.errors import InputError
from hyst_control.control.feedback.loop import Plant, run_loop
from hyst_control.control.feedback.pi import PI
from hyst_control.control.loop_margins import Margins, margins
from hyst_control.control.tuning import Tuning, controller_response
from hyst_control.records.excitation.excitation import cosine_ramp, multisine
from hyst_control.reporting.tables import Table
from hyst_plant_sim.physics import load_plant

MEASURED = {"fsm": ((1930.0, 1965.0), 1.0, 0.02, 100.0), "pea": ((1231.0,), 6.0, 0.1, 150.0)}
"""First modes in Hz, of the plants' files: only for moving them where the tuned loop is put to the test; operating point and rms
of the reference's multisine in the measurement unit; upper rating in V."""
PERIODS, SETTLING_PERIODS = 6, 2
SMOOTHED = 5
"""Neighbouring lines over which the plant's response is averaged: the distortion that the hysteresis scatters is not its gain."""


def measured_margins(plant: Plant, controller: PI, axes: int, axis: int, centre: float, rms: float, period: float = 0.2) -> Margins:
    """Margins of PI feedback around a plant about an operating point.

    The reference of `axis` is `centre` plus a multisine, the others rest at the centre. With P = Y / U at the lines of the multisine,
    L = P C is exact for the sampled loop wherever P is linear.
    """
    ts = controller.sample_time
    wave = multisine(ts, period, 1.0 / period, 0.48 / ts, rms, 1, centre, PERIODS, seed=axis)[:, 0]
    lead = np.concatenate([cosine_ramp(ts, 0.0, centre, 0.2), np.full(int(0.1 / ts), centre)])
    reference = np.repeat(np.concatenate([lead, np.full(len(wave), centre)])[:, None], axes, axis=1)
    reference[len(lead) :, axis] = wave
    signals = run_loop(reference, None, controller.start(axes), plant)
    count = int(round(period / ts))

    def spectra(name: str) -> tuple[Complex, Complex]:
        rows = signals[name][len(lead) + SETTLING_PERIODS * count :, axis].reshape(-1, count)
        each = np.fft.rfft(rows, axis=1)
        return each.mean(axis=0), each

    line = np.flatnonzero(np.abs(np.fft.rfft(wave[:count])) > 1e-6 * count * rms)
    line = line[line > 0]
    command, _ = spectra("command")
    measurement, each = spectra("measurement")
    scatter = np.sqrt(np.mean(np.abs(each[:, line] - measurement[line]) ** 2) / np.mean(np.abs(measurement[line]) ** 2))
    if not np.isfinite(scatter) or scatter > 0.5:
        raise InputError("margins: the closed loop does not settle to the period of its reference: it is not stable")
    kernel = np.ones(SMOOTHED)
    weight = np.abs(command[line]) ** 2
    # Weighted mean of Y / U over neighbouring lines, the plant's phase being nearly straight there.
    z = np.exp(2j * np.pi * line / count)
    ratio = np.convolve(measurement[line] * command[line].conj() * z**2, kernel, "same") / np.convolve(weight, kernel, "same")
    response = ratio / z**2 * controller_response(controller, z)
    return margins(response, z, ts)


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
