# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""A stage that remembers what was written, and a source of commands for it, for the tests of nodes on hardware."""

from __future__ import annotations

import threading
import time

import numpy as np
from lifecycle_msgs.srv import ChangeState

from hyst_control.hardware import StageNode

RATE = 200.0
PERIOD = 1 / RATE
LOWER, UPPER, SLEW, SAFE, SAFE_RATE, TIMEOUT = -5.0, 60.0, 2000.0, 3.0, 1000.0, 0.25
SETTINGS = dict(
    rate_hz=RATE,
    lower=LOWER,
    upper=UPPER,
    slew_limit=SLEW,
    safe_command=[SAFE],
    safe_rate=SAFE_RATE,
    timeout=TIMEOUT,
    failures=5,
)


class Drive(StageNode):
    """A stage of 0.1 um/V that remembers what was written, and fails by what `fault` names."""

    PRESENT = [20.0]

    def __init__(self, **options):
        self.written: list[float] = []
        self.left: list[float | None] = []  # what was written last before each disconnection
        self.connections = self.open = 0
        self.fault = ""
        self.answering = threading.Event()  # ends what hangs
        self.answer = None
        super().__init__(**options)

    def connect(self):
        if "hanging connect" in self.fault:
            self.answering.wait()
        elif self.fault == "connect":
            raise OSError("no such device")
        self.connections += 1
        self.open += 1

    def disconnect(self):
        self.open -= 1
        self.left.append(self.written[-1] if self.written else None)
        if "disconnect" in self.fault:
            raise OSError("already closed")

    def initial_command(self):
        return self.PRESENT

    def read(self):
        if "hanging read" in self.fault:
            self.answering.wait()
        elif "read" in self.fault:
            raise OSError("sensor error")
        if "connection" in self.fault:
            raise ConnectionResetError("the device has gone")
        return self.answer if self.answer is not None else [0.1 * (self.written[-1] if self.written else 20.0)]

    def write(self, command):
        if "hanging write" in self.fault:
            self.answering.wait()
        elif "write" in self.fault:
            raise OSError("converter error")
        if "deaf" in self.fault:
            raise BrokenPipeError("the device does not listen")
        assert command.shape == (1,)
        self.written.append(float(command[0]))


def failed_calls(node):
    """Number of calls of the device that have failed."""
    return node.counts["read: failed"] + node.counts["write: failed"]


class Bed:
    """A stage, and a source of commands on the clock of this machine."""

    def __init__(self, bench, make=Drive, label="t[s],x[V]", **changes):
        self.bench, self.value, self.sending = bench, 40.0, True
        bench.listen("measurement", "applied")
        bench.listen_to_diagnostics()
        self.node = bench.add(make, **{**SETTINGS, **changes})
        self.sender = bench.sender("command", label)
        self.timer = bench.probe.create_timer(PERIOD, self.feed)

    def feed(self):
        if self.sending:
            tick = int(time.monotonic() / PERIOD)
            self.sender.send(np.array([[tick * PERIOD, *np.atleast_1d(self.value)]]))

    @property
    def last(self):
        return self.node.written[-1] if self.node.written else None

    def assert_sound(self, begin=20.0):
        """Every written value is in range, and none is further from the one before than the slope allows."""
        written = np.array([begin, *self.node.written])
        assert np.isfinite(written).all() and written.min() >= LOWER and written.max() <= UPPER
        assert np.abs(np.diff(written)).max() <= SLEW * PERIOD * (1 + 1e-9)


def change(bench, node, label):
    request = ChangeState.Request()
    request.transition.label = label
    return bench.call(ChangeState, f"{node}/change_state", request).success
