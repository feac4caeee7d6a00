# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A simulator that is a functional mock-up unit (FMU), beside a record of the same stage whose command arrives late.

The unit is what `hyst export --fmu` makes of a model, its C compiled here. FMPy runs it as it runs any unit for co-simulation by FMI 2.0:
take yours in its place. `pip install FMPy` is all that it needs besides.
"""

from __future__ import annotations

import tempfile
from functools import cache, lru_cache
from pathlib import Path

import numpy as np

import hyst_control as hc
from hyst_control.base.arrays import Array
from hyst_control.chain import Chain
from hyst_control.chain.hysteresis.prandtl_ishlinskii import PrandtlIshlinskii
from hyst_control.chain.linear.linear_stages import TransferFunction
from hyst_control.export.fmu import write_fmu
from hyst_control.export.programs import simulator
from hyst_control.model_file import Model

try:
    import fmpy
    from fmpy.fmi2 import FMU2Slave
except ImportError:
    raise SystemExit("fmu_stage: needs FMPy: pip install FMPy") from None

PARAMETERS = {"gain": (1.0, 0.01)}
RATE = 1000.0
OMEGA = 2 * np.pi * 60.0
STAGES = (PrandtlIshlinskii([5.0, 15.0], [0.02, 0.015], w0=0.08), TransferFunction([OMEGA**2], [1.0, 0.2 * OMEGA, OMEGA**2]))
MODEL = Model("stage", ("x",), {"command": "V", "measurement": "um"}, 1.0 / RATE, Chain(STAGES))


@cache
def unit() -> tuple[FMU2Slave, list[int], list[int]]:
    """The unit, loaded, and the numbers of its inputs and outputs."""
    path = write_fmu(simulator(MODEL).program, Path(tempfile.mkdtemp()) / "stage.fmu")
    description = fmpy.read_model_description(str(path))
    loaded = fmpy.instantiate_fmu(fmpy.extract(str(path)), description, "CoSimulation")
    inputs, outputs = (
        [each.valueReference for each in description.modelVariables if each.causality == causality]
        for causality in ("input", "output")
    )
    return loaded, inputs, outputs


@lru_cache
def output(command: bytes, sample_time: float) -> Array:
    """Measurement of a command, whose every sample is taken before the command of its tick acts."""
    if abs(sample_time * RATE - 1.0) > 1e-9:
        raise ValueError(f"the unit has ticks of {1e3 / RATE:g} ms")
    stage, inputs, outputs = unit()
    rows = np.frombuffer(command).tolist()
    stage.reset()
    stage.setupExperiment()
    stage.enterInitializationMode()
    stage.setReal(inputs, rows[:1])
    stage.exitInitializationMode()
    measurement = stage.getReal(outputs)
    for tick, row in enumerate(rows[:-1]):
        stage.setReal(inputs, [row])
        stage.doStep(tick * sample_time, sample_time)
        measurement += stage.getReal(outputs)
    return np.array(measurement)


def simulate(command: Array, sample_time: float, gain: float) -> Array:
    """The unit, whose output has a gain of its own here; it runs once a command."""
    return gain * output(command.tobytes(), sample_time)


def measured(seed: int = 0, late: int = 4) -> hc.Record:
    """Record the machine: its amplifier is a network away, and every command acts four ticks later."""
    random = np.random.default_rng(seed)
    command = np.repeat(random.uniform(0.0, 50.0, 40), random.integers(11, 30, 40))  # at even steps a delay is as well a hold
    command[:20] = 0.0
    stage = simulate(np.concatenate([np.zeros(late), command[:-late]]), 1.0 / RATE, 1.004)
    return hc.from_arrays(command, stage + 0.01 * random.standard_normal(len(stage)), RATE)


if __name__ == "__main__":
    print(hc.diagnose(measured(), simulate, parameters=PARAMETERS, verbose=False))
