# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Stage on converters of Linux' Industrial I/O (IIO): any DAC and ADC that has a kernel driver, through its files in sysfs.

The kernel gives raw counts, and for each channel an offset and a scale: millivolts = (raw + offset) * scale. The amplifier between DAC
and actuator and the sensor's conditioner in front of the ADC are factors of this node's parameters.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.hardware.stage_node import StageNode
from hyst_control.nodes.execution.run import executable
from hyst_control.nodes.signal_node.parameters import Setting

DEVICES = "/sys/bus/iio/devices"
MILLI = 1e-3


class IioChannel:
    """One channel of an IIO device; its file stays open."""

    def __init__(self, device: Path, name: str) -> None:
        self._raw = device / f"{name}_raw"
        kind = name.rstrip("0123456789")  # what all channels share stands under the kind
        self._scale = self._number(device, (f"{name}_scale", f"{kind}_scale"), None)
        self._offset = self._number(device, (f"{name}_offset", f"{kind}_offset"), 0.0)
        try:
            self._file = os.open(self._raw, os.O_WRONLY if name.startswith("out_") else os.O_RDONLY)
        except OSError as error:
            raise InputError(f"{self._raw}: {error.strerror}: give a channel of this device, and the right to use it") from None

    def volts(self) -> float:
        """Present reading, V."""
        return (float(os.pread(self._file, 64, 0)) + self._offset) * self._scale * MILLI

    def output(self, volts: float) -> None:
        """Put out `volts` (V), to the nearest count."""
        os.pwrite(self._file, b"%d\n" % round(volts / (self._scale * MILLI) - self._offset), 0)

    def present(self) -> float:
        """Voltage that an output has, V."""
        return (float(self._raw.read_text()) + self._offset) * self._scale * MILLI

    def close(self) -> None:
        """Close the file."""
        os.close(self._file)

    def _number(self, device: Path, names: tuple[str, ...], default: float | None) -> float:
        for name in names:
            if (device / name).exists():
                return float((device / name).read_text())
        if default is None:
            raise InputError(f"{device}: has no {names[0]}: give a voltage channel of it")
        return default


class IioStage(StageNode):
    """Node on a DAC and an ADC, which may be one device or two.

    Each axis has an output and an input. The actuator gets `amplifier_gain` times the voltage of the DAC, and the measurement is
    `sensor_gain` times the voltage of the ADC, plus `sensor_zero`.
    """

    NAME = "iio_stage"
    SETTINGS = (
        *StageNode.SETTINGS,
        Setting("devices", DEVICES, "", "folder of the IIO devices"),
        Setting("dac", "iio:device0", "", "device of the outputs, by the name of its folder or the name that it gives itself"),
        Setting("adc", "iio:device1", "", "device of the inputs"),
        Setting("outputs", ("out_voltage0",), "", "channel of the DAC for every axis"),
        Setting("inputs", ("in_voltage0",), "", "channel of the ADC for every axis"),
        Setting("amplifier_gain", 1.0, "V/V", "voltage on the actuator per voltage of the DAC", 1e-6, 1e6),
        Setting("sensor_gain", 1.0, "unit/V", "measurement per voltage of the ADC; negative for a reversed sensor", -1e6, 1e6),
        Setting("sensor_zero", 0.0, "um or mrad", "measurement at 0 V of the ADC", -1e6, 1e6),
    )

    def connect(self) -> None:
        """Open the channels."""
        given = self.settings
        self._outputs: list[IioChannel] = []
        self._inputs: list[IioChannel] = []
        try:
            for name, device, into in (("outputs", given.dac, self._outputs), ("inputs", given.adc, self._inputs)):
                channels = getattr(given, name)
                if len(channels) != len(self.axes):
                    raise InputError(f"parameter {name}: {len(channels)} channels, {len(self.axes)} axes")
                folder = _device(Path(given.devices), device)
                for channel in channels:
                    into.append(IioChannel(folder, channel))
        except Exception:
            self.disconnect()  # of those that were opened before: the node may try again any number of times
            raise

    def disconnect(self) -> None:
        """Close the channels; the DAC holds what it has."""
        for channel in (*self._outputs, *self._inputs):
            channel.close()

    def initial_command(self) -> Array:
        """Voltage (A,) on the actuator, V, from what the DAC holds."""
        gain = float(self.settings.amplifier_gain)
        return np.array([channel.present() * gain for channel in self._outputs])

    def read(self) -> Array:
        """Measurement (A,), um or mrad."""
        gain, zero = float(self.settings.sensor_gain), float(self.settings.sensor_zero)
        return np.array([channel.volts() * gain + zero for channel in self._inputs])

    def write(self, command: Array) -> None:
        """Put out a `command` (A,), V on the actuator."""
        for channel, volts in zip(self._outputs, command / self.settings.amplifier_gain):
            channel.output(float(volts))


def _device(devices: Path, wanted: str) -> Path:
    """Folder of a device."""
    found = {path.name: path for path in sorted(devices.glob("iio:device*"))}
    names = {(path / "name").read_text().strip(): path for path in found.values() if (path / "name").exists()}
    try:
        return found.get(wanted) or names[wanted]
    except KeyError:
        known = ", ".join([*found, *names]) or "none"
        raise InputError(f"{devices}: has no device {wanted} (devices: {known}): load its driver, or give another one") from None


main = executable(IioStage)

if __name__ == "__main__":
    raise SystemExit(main())
