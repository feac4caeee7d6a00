# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Stage on a simulated converter: a model file in real time, rounded to the steps of its converters, for trying a bench out."""

from __future__ import annotations

import time

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.hardware.stage_node import StageNode
from hyst_control.model_file import Simulator, load_model
from hyst_control.nodes.execution.run import executable
from hyst_control.nodes.signal_node.parameters import Setting


class Converter:
    """Simulated digital-to-analog and analog-to-digital converters with a stage between them, which runs as time passes."""

    MAX_STEPS = 10_000  # Samples computed at once; after a longer pause the stage has settled

    def __init__(self, simulator: Simulator, axes: int, period: float, output_step: float = 0.0, input_step: float = 0.0) -> None:
        self._simulator, self._period = simulator, period
        self._output_step, self._input_step = output_step, input_step
        self.voltage = np.zeros(axes)  # Voltage (A,) that is held, V
        self._value = simulator.reset(self.voltage)
        self._sample = int(time.monotonic() / period)

    def sample(self) -> Array:
        """Measurement (A,) of this moment, um or mrad."""
        now = int(time.monotonic() / self._period)
        steps = min(now - self._sample, self.MAX_STEPS)
        if steps > 0:
            self._value = self._simulator.step(np.repeat(self.voltage[None], steps, axis=0))[-1]
            self._sample = now
        return _rounded(self._value, self._input_step)

    def hold(self, voltage: Array) -> None:
        """Hold a voltage (A,) in V from now on."""
        self.sample()  # up to now it was the one before
        self.voltage = _rounded(voltage, self._output_step)


def _rounded(values: Array, step: float) -> Array:
    return np.rint(values / step) * step if step else values


class SimulatedStage(StageNode):
    """Node with a simulated converter."""

    NAME = "simulated_stage"
    SETTINGS = (
        *StageNode.SETTINGS,
        Setting("model", "", "", "model file of the stage"),
        Setting("output_step", 0.0, "V", "step of the digital-to-analog converter, 0 for none", 0.0, 1e3),
        Setting("input_step", 0.0, "um or mrad", "step of the measurement, 0 for none", 0.0, 1e3),
    )

    def connect(self) -> None:
        """Load the model."""
        given = self.settings
        if not given.model:
            raise InputError("parameter model: give a model file")
        model = load_model(given.model)
        self.check_fits(given.model, model.axes, model.units)
        self.converter = Converter(Simulator(model, self.period), len(self.axes), self.period, given.output_step, given.input_step)

    def initial_command(self) -> Array:
        """Voltage (A,) that the converter holds, V."""
        return self.converter.voltage

    def read(self) -> Array:
        """Measurement (A,), um or mrad."""
        return self.converter.sample()

    def write(self, command: Array) -> None:
        """Hold a `command` (A,), V."""
        self.converter.hold(command)


main = executable(SimulatedStage)

if __name__ == "__main__":
    raise SystemExit(main())
