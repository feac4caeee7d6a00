# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A simulator that is a scipy.signal.lti, beside a record of the same axis whose amplifier saturates.

From the folder `examples`: hyst diagnose BAG --simulator simulators.linear_system:simulate --parameters prior.yaml
"""

from __future__ import annotations

import numpy as np
from scipy import signal

import hyst_control as hc
from hyst_control.base.arrays import Array

PARAMETERS = {"gain": (0.1, 0.002, "um/V"), "frequency": (80.0, 1.0, "Hz"), "damping": (0.05, 0.005)}
RATE = 2000.0


def simulate(command: Array, sample_time: float, gain: float, frequency: float, damping: float) -> Array:
    """An oscillator; the command is held between the samples."""
    omega = 2 * np.pi * frequency
    plant = signal.lti([gain * omega**2], [1.0, 2 * damping * omega, omega**2])
    num, den, _ = signal.cont2discrete((plant.num, plant.den), sample_time)
    measurement: Array = signal.lfilter(num.ravel(), den, command)
    return measurement


def measured(seed: int = 0) -> hc.Record:
    """Record the machine: its amplifier gives no more than 30 V."""
    random = np.random.default_rng(seed)
    command = np.repeat(random.uniform(-40.0, 40.0, 40), 20)
    command[:20] = 0.0
    stage = simulate(np.clip(command, -30.0, 30.0), 1.0 / RATE, 0.1005, 80.3, 0.049)
    return hc.from_arrays(command, stage + 0.005 * random.standard_normal(len(stage)), RATE)


if __name__ == "__main__":
    print(hc.diagnose(measured(), simulate, parameters=PARAMETERS, verbose=False))
