# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A simulator that is a neural network in numpy (NARX), beside a record of the same stage through a slow sensor."""

from __future__ import annotations

import numpy as np

import hyst_control as hc
from hyst_control.base.arrays import Array

PARAMETERS = {"slope": (1.0, 0.01), "bend": (0.3, 0.02)}
RATE = 1000.0
HIDDEN = np.array([[1.2, 0.5], [-0.7, 0.9], [0.4, -1.1]])
OUTPUT = np.array([0.25, -0.15, 0.1])


def simulate(command: Array, sample_time: float, slope: float, bend: float) -> Array:
    """y[k+1] = 0.8 y[k] + slope u[k]/50 + bend · tanh network of u[k] and y[k]."""
    measurement = np.zeros(len(command))
    for k, u in enumerate(command[:-1] / 10.0):
        y = measurement[k]
        measurement[k + 1] = 0.8 * y + 0.2 * slope * u + bend * OUTPUT @ np.tanh(HIDDEN @ (u, y))
    return measurement


def measured(seed: int = 0) -> hc.Record:
    """Record the machine: its sensor follows with a lag of 15 Hz, stepped finely here, and its slope is 0.6 % off."""
    random = np.random.default_rng(seed)
    command = np.repeat(random.uniform(-10.0, 10.0, 40), 20)
    command[:20] = 0.0
    stage, sensor, rows = simulate(command, 1.0 / RATE, 1.006, 0.3), 0.0, [0.0]
    for before, now in zip(stage[:-1], stage[1:], strict=True):
        for share in (np.arange(50) + 0.5) / 50:
            sensor += 2 * np.pi * 15.0 / RATE / 50 * (before + share * (now - before) - sensor)
        rows.append(sensor)
    return hc.from_arrays(command, rows + 0.002 * random.standard_normal(len(rows)), RATE)


if __name__ == "__main__":
    print(hc.diagnose(measured(), simulate, parameters=PARAMETERS, verbose=False))
