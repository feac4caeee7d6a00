# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""Stage on a controller of Physik Instrumente (PI) over TCP/IP, through PI's own package `pipython` and its General Command Set (GCS).

The controller's servo is switched off: the loop is closed here. `SVA` sets an axis' piezo voltage, `POS?` reads its sensor. One tick
needs two exchanges over the network, about a millisecond each: 100 to 300 Hz are usual, faster loops belong on the controller.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from typing import Any

from hyst_control.base.arrays import Array
from hyst_control.base.errors import InputError
from hyst_control.hardware.stage_node import StageNode
from hyst_control.nodes.execution.run import executable
from hyst_control.nodes.signal_node.parameters import Setting

ERROR_CHECK_INTERVAL = 1.0
"""s, between two questions for the controller's error, which would cost a third exchange at every tick."""

ANSWER_TIMEOUT = 1.0
"""s. The driver waits this long for an answer. Then it gives the connection up, because an answer that comes later would be taken for
that of the next question; voltages, which have no answer, can still be set."""


class GcsController:
    """Connection with one controller; all that is used of `pipython` is here. A question without an answer raises `ConnectionError`."""

    identity: str  # The controller's own name and version

    def __init__(self, host: str, port: int, axes: list[str]) -> None:
        try:
            from pipython import GCSDevice, gcserror
            from pipython.pidevice.interfaces.pisocket import PISocket
        except ImportError as error:
            raise InputError(f"pipython cannot be imported ({error}): pip install PIPython") from None

        class Gateway(PISocket):
            """Socket whose `close` may be called twice, as `GCSDevice` does, and after the controller has closed the connection."""

            def close(self) -> None:
                if self.connected:
                    with suppress(OSError):
                        super().close()

        try:
            gateway = Gateway(host, port)
        except OSError as error:
            raise InputError(f"{host}:{port}: {error.strerror}: is the controller on, and is this its address?") from None
        gateway.settimeout(ANSWER_TIMEOUT * 1e3)
        self._axes = axes
        self._errors: Any = gcserror
        self._checked = time.monotonic()
        with ExitStack() as opened:  # closed again at any failure: a controller takes only few connections
            opened.callback(gateway.close)
            try:
                # `pipython` forgets a device only when its context ends; one that it has kept is asked again at the next connection.
                self._device: Any = opened.enter_context(GCSDevice(gateway=gateway))
                known = list(self._device.qSAI())
                if unknown := [axis for axis in axes if axis not in known]:
                    raise InputError(
                        f"{host}: has no axis {', '.join(unknown)} (axes: {', '.join(known)}): set the parameter controller_axes"
                    )
                self._device.SVO(axes, [False] * len(axes))  # the loop is closed here
                self._device.errcheck = False
                self.identity = str(self._device.qIDN()).strip()
            except gcserror.GCSError as error:
                raise InputError(f"{host}:{port}: {error}: is this a controller of Physik Instrumente?") from None
            self._connection = opened.pop_all()

    def voltages(self) -> list[float]:
        """Voltages that are set, V."""
        found = self._ask(self._device.qSVA, self._axes)
        return [float(found[axis]) for axis in self._axes]

    def positions(self) -> list[float]:
        """Readings of the sensors, in the controller's unit, um or mrad."""
        found = self._ask(self._device.qPOS, self._axes)
        return [float(found[axis]) for axis in self._axes]

    def set_voltages(self, volts: list[float]) -> None:
        """Set `volts` (V). Raises an error of the controller at most once per `ERROR_CHECK_INTERVAL`."""
        self._device.SVA(self._axes, volts)
        if time.monotonic() - self._checked > ERROR_CHECK_INTERVAL:
            self._checked = time.monotonic()
            if code := self._ask(self._device.qERR):
                raise OSError(f"the controller reports error {code}")

    def _ask(self, question: Callable[..., Any], *arguments: Any) -> Any:
        """Answer of the controller; raises `ConnectionError` when there is none."""
        try:
            return question(*arguments)
        except self._errors.GCSError as error:
            if error == self._errors.E_7_COM_TIMEOUT:
                self._checked = math.inf  # nothing is asked any more
                raise ConnectionError(f"no answer for {ANSWER_TIMEOUT:g} s") from None
            raise

    def close(self) -> None:
        """End the connection, if the controller has not ended it; the controller holds its voltages."""
        self._connection.close()


class PhysikInstrumenteStage(StageNode):
    """Node on a controller of Physik Instrumente."""

    NAME = "pi_stage"
    SETTINGS = (
        *StageNode.SETTINGS,
        Setting("host", "", "", "address of the controller"),
        Setting("port", 50000, "1", "its TCP port", 1, 65535),
        Setting("controller_axes", ("1",), "", "the controller's name of every axis"),
    )

    def connect(self) -> None:
        """Connect, and switch the servo off."""
        given = self.settings
        if not given.host:
            raise InputError("parameter host: give the address of the controller")
        if len(given.controller_axes) != len(self.axes):
            raise InputError(f"parameter controller_axes: {len(given.controller_axes)} names, {len(self.axes)} axes")
        self.controller = GcsController(given.host, given.port, list(given.controller_axes))
        self.get_logger().info(f"connected with {self.controller.identity}")

    def disconnect(self) -> None:
        """End the connection."""
        self.controller.close()

    def initial_command(self) -> list[float]:
        """Voltages that the controller has, V."""
        return self.controller.voltages()

    def read(self) -> list[float]:
        """Readings of the sensors."""
        return self.controller.positions()

    def write(self, command: Array) -> None:
        """Set a `command` (A,), V."""
        self.controller.set_voltages(command.tolist())


main = executable(PhysikInstrumenteStage)

if __name__ == "__main__":
    raise SystemExit(main())
