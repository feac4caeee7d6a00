# Copyright 2026 The hyst_control authors
# SPDX-License-Identifier: Apache-2.0
"""An independent watcher of `command`: plain rclpy and nothing of the package, in a thread of its own."""

from __future__ import annotations

import math
import threading
from functools import partial

import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64MultiArray


class CommandWatcher:
    """Records every row of `command`, and of `applied` what the actuator is said to have, as they arrive.

    A row of `command` may differ by `step` at most from the row before it, or from what was said to be on the actuator since.
    """

    def __init__(self, domain, period, lower, upper, step):
        self.period, self.lower, self.upper, self.step = period, lower, upper, step
        self.rows = []  # (topic, tick, values), in order of arrival
        self._commands = []  # those of `command`: asked for again and again while a test waits
        self._sent = []  # times of sending: an executor does not keep the order of two topics
        self.foreign = set()  # values of rivals
        self._context = rclpy.Context()
        rclpy.init(context=self._context, domain_id=domain)
        self._node = rclpy.create_node("watcher", context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        for topic in ("command", "applied"):
            self._node.create_subscription(Float64MultiArray, topic, partial(self._note, topic), QoSProfile(depth=5000))
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def _spin(self):
        while not self._over.is_set():
            self._executor.spin_once(timeout_sec=0.1)

    def _note(self, topic, message, information):
        columns = message.layout.dim[1].size
        data = list(message.data)
        for begin in range(0, len(data), columns):
            time, *values = data[begin : begin + columns]
            tick = round(time / self.period) if math.isfinite(time) and abs(time) < 1e200 else None
            self._sent.append(information["source_timestamp"])
            self.rows.append((topic, tick, tuple(values)))
            if topic == "command":
                self._commands.append((tick, tuple(values)))

    def command(self, since=0):
        """Rows (tick, values) of `command` that are no rival's, from this one on in order of arrival."""
        return [row for row in self._commands if row[1] not in self.foreign][since:]

    @property
    def applied(self):
        return [values for topic, _, values in list(self.rows) if topic == "applied"]

    @property
    def last(self):
        return next((values for _, values in reversed(self._commands) if values not in self.foreign), None)

    def check(self):
        """Every row to the last one: finite, within the limits, and no further from the actuator than the slew limit allows.

        The first rows of a publisher may pass before it is known here: over ticks that were not heard the slew limit holds as a whole.
        What is heard last before them is on `applied`, at every tick, where there is no command.
        """
        known, last, applied = {}, None, None
        for number in sorted(range(len(self.rows)), key=self._sent.__getitem__):
            topic, tick, values = self.rows[number]
            where = f"row {number}, {topic} of tick {tick}: {values} after {last}, applied {applied}"
            assert all(math.isfinite(value) for value in values), where
            if topic == "applied":
                applied = tick, values
            elif values not in self.foreign:
                assert tick is not None and all(self.lower - 1e-9 <= value <= self.upper + 1e-9 for value in values), where
                if tick in known:
                    assert known[tick] == values, f"{where}: was {known[tick]} before"
                    continue
                known[tick] = values
                if last is None or tick > last[0]:
                    before = [each for each in (last, applied) if each is not None and each[0] is not None]
                    assert last is None or any(self._follows(tick, values, *each) for each in before), where
                    last, applied = (tick, values), None

    def _follows(self, tick, values, tick_before, before):
        step = self.step * max(tick - tick_before, 1)
        return all(abs(a - b) <= step * (1 + 1e-9) for a, b in zip(values, before))

    def close(self):
        self._over.set()
        self._thread.join(5.0)
        self._node.destroy_node()
        rclpy.try_shutdown(context=self._context)
