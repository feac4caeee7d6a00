# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Stability margins of a loop as measured on a running plant: a multisine on the reference, the loop closed all the while."""

from __future__ import annotations

import numpy as np

from hyst_control.base.arrays import Complex
from hyst_control.base.errors import InputError
from hyst_control.control.feedback.loop import Plant, run_loop
from hyst_control.control.feedback.pi import PI
from hyst_control.control.tuning import Margins, controller_response, margins
from hyst_control.records.excitation.excitation import cosine_ramp, multisine

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
